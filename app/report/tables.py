"""The statistics as tables, as the page and the JSON have them."""

from app.report.looks import Look
from app.report.statistics import PARAMETERS, SIGNIFICANT, Extent, Statistics
from config.schema import TissueLibrary
from estimator.studies.page import Table
from estimator.studies.printed_tables import TABLE_6_N, TABLE_6_S, TABLE_7, TISSUES

UNITS = {"alpha": "α, N", "beta": "β, 1/m", "d": "d, kg/s"}
GREEK = {"alpha": "α", "beta": "β", "d": "d"}
EXTREMES = ("max", "mean", "min")


def statistics_tables(found: Statistics, library: TissueLibrary, looks: dict[str, Look]) -> list[Table]:
    """Tables VI and VII, Tukey's comparisons, and what tells which pair apart."""
    if not found.groups:
        return []
    tables = [_table_6(found, looks), _table_7(found, library, looks)]
    if any(one.pairs for one in found.tukey.values()):
        tables += [_tukey(found, looks), _tell_apart(found, looks)]
    return tables


def _table_6(found: Statistics, looks: dict[str, Look]) -> Table:
    rows = []
    for name, row in found.table_6.items():
        printed = TISSUES.index(name) if name in TISSUES else None
        kinds = [
            ("convergence time, s", row.convergence_s, TABLE_6_S),
            ("force error, means of grasps, N", row.error_n, None),
            ("force error, single samples, N", row.sample_error_n, TABLE_6_N),
        ]
        for what, extent, paper in kinds:
            theirs = (None, None, None) if paper is None or printed is None else paper[printed]
            rows.append([looks[name].title, what, row.grasps, extent.count, *_values(extent), *theirs])
    return Table(
        "Table VI: convergence time and force error",
        ["tissue", "of", "grasps", "counted", *EXTREMES, *(f"paper: {word}" for word in EXTREMES)],
        rows,
        "Of the tissue's own filter; of a group that is not in the library, of the likeliest tissue's. The time counts "
        "from contact until the error stays within 15 % of the grasp's largest force; a grasp where it never does is "
        "not counted. Force error: estimated less measured, while the tissue is held; the mean of single samples is "
        "that of the grasps' means. A filter whose force is off by more than a hundred times the largest measured one "
        "has diverged, and its force error is not counted. The paper does not say which of the two errors it prints.",
    )


def _values(extent: Extent) -> list[float | None]:
    return [extent.largest, extent.mean, extent.smallest]


def _table_7(found: Statistics, library: TissueLibrary, looks: dict[str, Look]) -> Table:
    rows = []
    for name, parameters in found.table_7.items():
        profile = library.tissues.get(name)
        for parameter, value in parameters.items():
            rows.append(
                [
                    looks[name].title,
                    UNITS[parameter],
                    len(found.groups[name]),
                    value.mean,
                    value.geometric_mean,
                    value.log_sd,
                    getattr(profile, PARAMETERS[parameter]) if profile else None,
                    _printed_7(parameter, name, library),
                ]
            )
    return Table(
        "Table VII: parameters at the grasp's end",
        ["tissue", "of", "grasps", "mean", "geometric mean", "SD of the logarithm", "library", "paper: mean"],
        rows,
        "Of the filter that explains the grasp best. The paper's means in these units: its α read in mN (bladder's in "
        "N) and its β divided by the library's thickness.",
    )


def _printed_7(parameter: str, name: str, library: TissueLibrary) -> float | None:
    if name not in TISSUES or name not in library.tissues:
        return None
    printed = TABLE_7[parameter][TISSUES.index(name)]
    if parameter == "alpha":
        return printed if name == "bladder" else printed / 1e3
    return printed / library.tissues[name].thickness_m if parameter == "beta" else printed


def _tukey(found: Statistics, looks: dict[str, Look]) -> Table:
    rows = []
    for pair in found.tell_apart():
        row: list[str | None] = [" / ".join(looks[name].title for name in pair)]
        for one in found.tukey.values():
            compared = one.pairs.get(pair)
            if compared is None:
                row += [None, None]
                continue
            interval = f"{compared.ratio:.3g} ({compared.low:.3g} to {compared.high:.3g})"
            row += [interval, p_in_words(compared.p)]
        rows.append(row)
    columns = [column for name in found.tukey for column in (f"{GREEK[name]}: ratio (95 %)", f"{GREEK[name]}: p")]
    return Table(
        "Tukey's honestly significant differences",
        ["pair", *columns],
        rows,
        "Ratio of the geometric means, the first tissue's by the second's, with its 95 % interval for all pairs "
        "together. On logarithms: specimens scatter by factors, and the test takes all tissues to scatter alike.",
    )


def _tell_apart(found: Statistics, looks: dict[str, Look]) -> Table:
    rows = []
    for pair, telling in found.tell_apart().items():
        words = ", ".join(GREEK[name] for name in telling) or "none of them"
        rows.append([" and ".join(looks[name].title for name in pair), words])
    return Table(f"What tells which pair apart (p < {SIGNIFICANT:g})", ["pair", "parameters"], rows)


def p_in_words(p: float) -> str:
    """A probability that is never told as nothing."""
    return "<\u00a00.001" if p < 0.001 else f"{p:.3f}"
