"""The formats of exports."""

from enum import StrEnum


class ExportFormat(StrEnum):
    """What an export is written as."""

    CSV = "csv"
    PARQUET = "parquet"
    MAT = "mat"
    MCAP = "mcap"
