"""Load configuration files by name or path; an error lists all faults of a file with their places."""

import difflib
import json
import tomllib
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from config.errors import ConfigurationError
from config.plausible_ranges import check_plausible
from config.schema import GraspProtocol, Settings, TissueLibrary, Tool
from config.tissue_names import check_tissue_names

CONFIG_DIR = Path(__file__).parent

# pydantic adds these tags to a fault's place, but the file does not contain them
UNION_TAGS = ("trapezoid", "sine", "custom", "table", "number")

MAX_CHARACTERS = 2**24  # a learned library has some hundred thousand
MAX_NESTING_DEPTH = 50  # depth of nested tables and arrays; the shipped files have five
MAX_LISTED_ERRORS = 100

ModelT = TypeVar("ModelT", bound=BaseModel)


def load_settings(path: Path | None = None) -> Settings:
    """Load the service's settings from `path`, or from the shipped `graspwatch.toml`."""
    return load_file(path or CONFIG_DIR / "graspwatch.toml", Settings)


def load_tool(name: str) -> Tool:
    return load_file(find_tool_file(name), Tool)


def find_tool_file(name: str) -> Path:
    """Return the path of a tool file from its name or path."""
    return _find_file(name, "tools", "tool")


def load_library(name: str) -> TissueLibrary:
    library = _load_named(name, "tissues", "tissue library", TissueLibrary)
    if library.learned and library.learned.session_scale is not None:
        raise ConfigurationError(
            f"{name}: an earlier version learned this library, and took spots of one tissue for more alike than they "
            "are. Learn it anew with `graspwatch learn`."
        )
    return library


def build_graspable_library(library: TissueLibrary) -> TissueLibrary:
    """Return a library of everything that a simulated grasper can hold: its tissues, and things outside the library."""
    out_of_library = load_library("strangers")
    others = {
        name: profile.model_copy(update={"spread": out_of_library.spread_of(name)})
        for name, profile in out_of_library.tissues.items()
        if name not in library.tissues
    }
    return library.model_copy(update={"tissues": {**library.tissues, **others}})


def load_grasp_protocol(name: str) -> GraspProtocol:
    return _load_named(name, "protocols", "protocol", GraspProtocol)


def list_shipped_names(folder: str) -> list[str]:
    """Return the names of the shipped files in `tools`, `tissues` or `protocols`."""
    return sorted(path.stem for path in (CONFIG_DIR / folder).glob("*.toml"))


def read_modification_times(folder: str) -> tuple[int, ...]:
    """Return the modification times of the shipped files in `tools`, `tissues` or `protocols`, ns."""
    return tuple(path.stat().st_mtime_ns for path in sorted((CONFIG_DIR / folder).glob("*.toml")))


def require_known_name(name: str, names: list[str], what: str) -> str:
    """Return `name` if it is one of `names`.

    Raises:
        ConfigurationError: it is not; the text lists the names.
    """
    if name in names:
        return name
    close = difflib.get_close_matches(name, names, n=1)
    hint = f" Did you mean {close[0]!r}?" if close else ""
    raise ConfigurationError(f"There is no {what} {name!r}.{hint} There is: {', '.join(names)}.")


def _load_named(name: str, folder: str, what: str, model: type[ModelT]) -> ModelT:
    return load_file(_find_file(name, folder, what), model)


def _find_file(name: str, folder: str, what: str) -> Path:
    """Return a shipped file by its name, or any file by its path (recognized by `/` or `.toml`)."""
    if name.endswith(".toml") or "/" in name:
        return Path(name)
    return CONFIG_DIR / folder / f"{require_known_name(name, list_shipped_names(folder), what)}.toml"


def load_file(path: Path, model: type[ModelT]) -> ModelT:
    """Parse and validate one TOML file.

    Raises:
        ConfigurationError: the file is missing, is not TOML, or has faults; the text lists all faults with their keys.
    """
    try:
        content = tomllib.loads(_read_text(path))
        _check_nesting_depth(content)
        as_json = json.dumps(content, default=str)
    except FileNotFoundError:
        raise ConfigurationError(f"{path}: there is no such file. Check the path.") from None
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigurationError(f"{path}: cannot be read as a text file ({error}).") from None
    except (tomllib.TOMLDecodeError, ValueError) as error:  # ValueError: a number with thousands of digits
        raise ConfigurationError(f"{path}: is not valid TOML: {error}.") from None
    except RecursionError:
        raise ConfigurationError(f"{path}: holds tables within tables without end. Check the file.") from None
    try:  # via JSON, whose strict mode accepts arrays for tuples and strings for enums, but not "5" for 5
        loaded = model.model_validate_json(as_json)
    except ValidationError as error:
        raise ConfigurationError(describe_validation_errors(str(path), error, model)) from None
    if isinstance(loaded, TissueLibrary):  # not so for those in recordings, which older versions wrote
        check_tissue_names(loaded.tissues, f"{path}: tissues")
    if isinstance(loaded, Tool):
        check_plausible(loaded, str(path))
    return loaded


def _check_nesting_depth(content: dict[str, Any]) -> None:
    """Raise RecursionError if tables or arrays are nested too deep, as parsers do at their own limit."""
    level: list[Any] = [content]
    for _ in range(MAX_NESTING_DEPTH):
        inside = (each.values() if isinstance(each, dict) else each for each in level)
        level = [value for values in inside for value in values if isinstance(value, dict | list)]
        if not level:
            return
    raise RecursionError


def _read_text(path: Path) -> str:
    with path.open(encoding="utf-8") as file:
        text = file.read(MAX_CHARACTERS + 1)
    if len(text) > MAX_CHARACTERS:
        raise ConfigurationError(f"{path}: is far too long for a configuration file. Check the path.")
    return text


def describe_validation_errors(where: str, error: ValidationError, model: type[BaseModel]) -> str:
    """Return one line per fault with file, key and fault, and the most similar valid key for an unknown key."""
    keys = sorted(_collect_keys(model.model_json_schema()))
    faults = [f"{where}: {_describe_validation_error(fault, keys)}" for fault in error.errors()[:MAX_LISTED_ERRORS]]
    found = error.error_count()
    more = [f"and {found - MAX_LISTED_ERRORS} more"] if found > MAX_LISTED_ERRORS else []
    return "\n".join([f"{found} fault{'s'[: found != 1]} to mend:", *faults, *more])


def _describe_validation_error(fault: Any, keys: list[str]) -> str:
    named = [part for part in fault["loc"] if part not in UNION_TAGS]
    place = ".".join(str(part) for part in named) or "(whole file)"
    if fault["type"] != "extra_forbidden":
        given = "" if fault["type"] == "missing" else f" (found {_shorten(fault['input'])})"
        return f"{place}: {fault['msg']}{given}"
    close = difflib.get_close_matches(str(fault["loc"][-1]), keys, n=1, cutoff=0.5)
    return f"{place}: unknown key" + (f"; did you mean {close[0]!r}? Units stand in the names." if close else "")


def _shorten(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _collect_keys(schema: Any) -> set[str]:
    """Return every property name in a JSON schema."""
    if isinstance(schema, list):
        return set().union(*(_collect_keys(item) for item in schema))
    if not isinstance(schema, dict):
        return set()
    keys = set(schema.get("properties", {}))
    return keys.union(*(_collect_keys(value) for value in schema.values()))
