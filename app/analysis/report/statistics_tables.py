"""Functions that build the tables of the statistics, for a report's page and JSON."""

from app.analysis.report.statistics import PARAMETERS, SIGNIFICANCE_LEVEL, Statistics, ValueSummary
from app.analysis.report.tissue_styles import TissueStyle
from config.schema import TissueLibrary
from estimator.studies.html_page import Table
from estimator.studies.paper_tables import TABLE_6_N, TABLE_6_S, TABLE_7, TISSUES

PARAMETER_LABELS = {"alpha": "α, N", "beta": "β, 1/m", "d": "d, kg/s"}
PARAMETER_SYMBOLS = {"alpha": "α", "beta": "β", "d": "d"}
SUMMARY_COLUMNS = ("max", "mean", "min")


def build_statistics_tables(
    statistics: Statistics, library: TissueLibrary, tissue_styles: dict[str, TissueStyle]
) -> list[Table]:
    """Build Tables VI and VII, Tukey's comparisons, and the parameters that tell each pair of tissues apart."""
    if not statistics.groups:
        return []
    tables = [
        _build_convergence_table(statistics, tissue_styles),
        _build_parameter_table(statistics, library, tissue_styles),
    ]
    if any(one.pairs for one in statistics.tukey.values()):
        tables += [
            _build_tukey_table(statistics, tissue_styles),
            _build_distinguishing_table(statistics, tissue_styles),
        ]
    return tables


def _build_convergence_table(statistics: Statistics, tissue_styles: dict[str, TissueStyle]) -> Table:
    rows = []
    for name, row in statistics.convergence.items():
        printed = TISSUES.index(name) if name in TISSUES else None
        kinds = [
            ("convergence time, s", row.convergence_s, TABLE_6_S),
            ("force error, means of grasps, N", row.error_n, None),
            ("force error, single samples, N", row.sample_error_n, TABLE_6_N),
        ]
        for what, extent, paper in kinds:
            theirs = (None, None, None) if paper is None or printed is None else paper[printed]
            rows.append([tissue_styles[name].title, what, row.grasps, extent.count, *_summary_cells(extent), *theirs])
    return Table(
        "Table VI: convergence time and force error",
        ["tissue", "of", "grasps", "counted", *SUMMARY_COLUMNS, *(f"paper: {word}" for word in SUMMARY_COLUMNS)],
        rows,
        "Of the tissue's own filter; of a group that is not in the library, of the likeliest tissue's. The time counts "
        "from contact until the error stays within 15 % of the grasp's largest force; a grasp where it never does is "
        "not counted. Force error: estimated less measured, while the tissue is held; the mean of single samples is "
        "that of the grasps' means. A filter whose force is off by more than a hundred times the largest measured one "
        "has diverged, and its force error is not counted. The paper does not say which of the two errors it prints.",
    )


def _summary_cells(extent: ValueSummary) -> list[float | None]:
    return [extent.largest, extent.mean, extent.smallest]


def _build_parameter_table(
    statistics: Statistics, library: TissueLibrary, tissue_styles: dict[str, TissueStyle]
) -> Table:
    rows = []
    for name, parameters in statistics.parameters.items():
        profile = library.tissues.get(name)
        for parameter, value in parameters.items():
            rows.append(
                [
                    tissue_styles[name].title,
                    PARAMETER_LABELS[parameter],
                    len(statistics.groups[name]),
                    value.mean,
                    value.geometric_mean,
                    value.log_sd,
                    getattr(profile, PARAMETERS[parameter]) if profile else None,
                    _find_paper_mean(parameter, name, library),
                ]
            )
    return Table(
        "Table VII: parameters at the grasp's end",
        ["tissue", "of", "grasps", "mean", "geometric mean", "SD of the logarithm", "library", "paper: mean"],
        rows,
        "Of the filter that explains the grasp best. The paper's means in these units: its α read in mN (bladder's in "
        "N) and its β divided by the library's thickness.",
    )


def _find_paper_mean(parameter: str, name: str, library: TissueLibrary) -> float | None:
    if name not in TISSUES or name not in library.tissues:
        return None
    printed = TABLE_7[parameter][TISSUES.index(name)]
    if parameter == "alpha":
        return printed if name == "bladder" else printed / 1e3
    return printed / library.tissues[name].thickness_m if parameter == "beta" else printed


def _build_tukey_table(statistics: Statistics, tissue_styles: dict[str, TissueStyle]) -> Table:
    rows = []
    for pair in statistics.find_distinguishing_parameters():
        row: list[str | None] = [" / ".join(tissue_styles[name].title for name in pair)]
        for one in statistics.tukey.values():
            compared = one.pairs.get(pair)
            if compared is None:
                row += [None, None]
                continue
            interval = f"{compared.ratio:.3g} ({compared.low:.3g} to {compared.high:.3g})"
            row += [interval, format_p_value(compared.p)]
        rows.append(row)
    columns = [
        column
        for name in statistics.tukey
        for column in (f"{PARAMETER_SYMBOLS[name]}: ratio (95 %)", f"{PARAMETER_SYMBOLS[name]}: p")
    ]
    return Table(
        "Tukey's honestly significant differences",
        ["pair", *columns],
        rows,
        "Ratio of the geometric means, the first tissue's by the second's, with its 95 % interval for all pairs "
        "together. On logarithms: specimens scatter by factors, and the test takes all tissues to scatter alike.",
    )


def _build_distinguishing_table(statistics: Statistics, tissue_styles: dict[str, TissueStyle]) -> Table:
    rows = []
    for pair, telling in statistics.find_distinguishing_parameters().items():
        words = ", ".join(PARAMETER_SYMBOLS[name] for name in telling) or "none of them"
        rows.append([" and ".join(tissue_styles[name].title for name in pair), words])
    return Table(f"What tells which pair apart (p < {SIGNIFICANCE_LEVEL:g})", ["pair", "parameters"], rows)


def format_p_value(p: float) -> str:
    """Format a p-value; a small one is given as a bound, never as zero."""
    return "<\u00a00.001" if p < 0.001 else f"{p:.3f}"
