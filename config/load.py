"""Read configuration files by name or path; every fault of a file is told at once, with its place."""

import difflib
import json
import tomllib
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from config.errors import ConfigurationError
from config.schema import GraspProtocol, Settings, TissueLibrary, Tool

CONFIG_DIR = Path(__file__).parent

UNION_TAGS = (
    "trapezoid",
    "sine",
    "custom",
    "table",
    "number",
)  # pydantic puts them into a fault's place; the file does not

MAX_CHARACTERS = 2**24  # a learned library has some hundred thousand
MAX_NESTING_DEPTH = 50  # tables and arrays within each other; a file of ours has five
MAX_LISTED_ERRORS = 100  # told at a time

ModelT = TypeVar("M", bound=BaseModel)


def load_settings(path: Path | None = None) -> Settings:
    """The service's settings from `path`, or the shipped `graspwatch.toml`."""
    return load_file(path or CONFIG_DIR / "graspwatch.toml", Settings)


def load_tool(name: str) -> Tool:
    return load_file(find_tool_file(name), Tool)


def find_tool_file(name: str) -> Path:
    """Where the tool's file lies, by its name or its path."""
    return _find_file(name, "tools", "tool")


def load_library(name: str) -> TissueLibrary:
    return _load_named(name, "tissues", "tissue library", TissueLibrary)


def build_graspable_library(library: TissueLibrary) -> TissueLibrary:
    """What a simulated grasper can be told to hold: the library's tissues, and things that are not in it."""
    out_of_library = load_library("strangers")
    others = {
        name: profile.model_copy(update={"spread": out_of_library.spread_of(name)})
        for name, profile in out_of_library.tissues.items()
        if name not in library.tissues
    }
    return library.model_copy(update={"tissues": {**library.tissues, **others}})


def load_protocol(name: str) -> GraspProtocol:
    return _load_named(name, "protocols", "protocol", GraspProtocol)


def list_shipped_names(folder: str) -> list[str]:
    """Names of the shipped files in `tools`, `tissues` or `protocols`."""
    return sorted(path.stem for path in (CONFIG_DIR / folder).glob("*.toml"))


def read_modification_times(folder: str) -> tuple[int, ...]:
    """When the shipped files in `tools`, `tissues` or `protocols` were changed last, ns each."""
    return tuple(path.stat().st_mtime_ns for path in sorted((CONFIG_DIR / folder).glob("*.toml")))


def require_known_name(name: str, names: list[str], what: str) -> str:
    """`name` if it is one of `names`.

    Raises:
        ConfigurationError: it is not; the text says what there is.
    """
    if name in names:
        return name
    close = difflib.get_close_matches(name, names, n=1)
    hint = f" Did you mean {close[0]!r}?" if close else ""
    raise ConfigurationError(f"There is no {what} {name!r}.{hint} There is: {', '.join(names)}.")


def _load_named(name: str, folder: str, what: str, model: type[ModelT]) -> ModelT:
    return load_file(_find_file(name, folder, what), model)


def _find_file(name: str, folder: str, what: str) -> Path:
    """A shipped file by its name, or any file by its path (recognised by `/` or `.toml`)."""
    if name.endswith(".toml") or "/" in name:
        return Path(name)
    return CONFIG_DIR / folder / f"{require_known_name(name, list_shipped_names(folder), what)}.toml"


def load_file(path: Path, model: type[ModelT]) -> ModelT:
    """Parse and validate one TOML file.

    Raises:
        ConfigurationError: the file is missing, is no TOML, or has faults; all faults are listed with their keys.
    """
    try:
        content = tomllib.loads(_read_text(path))
        _check_nesting_depth(content)
        as_json = json.dumps(content, default=str)
    except FileNotFoundError:
        raise ConfigurationError(f"{path}: there is no such file. Check the path.") from None
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigurationError(f"{path}: cannot be read as a text file ({error}).") from None
    except (tomllib.TOMLDecodeError, ValueError) as error:  # the latter for a number of thousands of digits
        raise ConfigurationError(f"{path}: is not valid TOML: {error}.") from None
    except RecursionError:
        raise ConfigurationError(f"{path}: holds tables within tables without end. Check the file.") from None
    try:  # through JSON: its strict mode takes arrays for tuples and strings for enums, but no "5" for 5
        return model.model_validate_json(as_json)
    except ValidationError as error:
        raise ConfigurationError(describe_validation_errors(str(path), error, model)) from None


def _check_nesting_depth(content: dict[str, Any]) -> None:
    """Raise RecursionError where tables or arrays are nested too deep, as parsers do at a depth of their own."""
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
    """One line a fault: file, key, what is wrong, and the nearest valid key where a key is unknown."""
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
    """Every property name anywhere in a JSON schema."""
    if isinstance(schema, list):
        return set().union(*(_collect_keys(item) for item in schema))
    if not isinstance(schema, dict):
        return set()
    keys = set(schema.get("properties", {}))
    return keys.union(*(_collect_keys(value) for value in schema.values()))
