"""The enumeration of the file formats of exports."""

from enum import StrEnum


class ExportFormat(StrEnum):
    """File format of an export."""

    CSV = "csv"
    PARQUET = "parquet"
    MAT = "mat"
    MCAP = "mcap"
