"""Functions that find and load configuration files by name or path; an error lists all faults with their places."""

import difflib
import json
import tomllib
from enum import StrEnum
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from config.errors import ConfigurationError
from config.home_folder import expand_home
from config.plausible_ranges import check_plausible
from config.schema import ConfigModel, GraspProtocol, Settings, TissueLibrary, Tool
from config.tissue_names import check_tissue_names

CONFIG_DIR = Path(__file__).parent

# pydantic adds these tags to a fault's place, but the file does not contain them
UNION_TAGS = ("trapezoid", "sine", "custom", "interval", "number", "int", "str")

TEXT_ENCODING = "utf-8-sig"  # UTF-8 with or without the byte order mark that editors on Windows write
BYTE_ORDER_MARK = "\ufeff"  # in texts that are no files
MAX_CHARACTERS = 2**24  # a learned library has some hundred thousand
MAX_NESTING_DEPTH = 50  # depth of nested tables and arrays; the shipped files have five
MAX_LISTED_ERRORS = 100
MAX_NAME_LENGTH = 64  # with a date and an ending, a file's name; file systems allow 255 bytes

ModelT = TypeVar("ModelT", bound=ConfigModel)
NamedT = TypeVar("NamedT", GraspProtocol, TissueLibrary, Tool)


class FileKind(StrEnum):
    """The kinds of files that are chosen by name: protocols, tissue libraries and tool files, shipped or own ones."""

    PROTOCOL = "protocol"
    LIBRARY = "library"
    TOOL = "tool"

    @property
    def folder(self) -> str:
        """Name of the folder of these files, in `config` and in the data folder."""
        return "tissues" if self is FileKind.LIBRARY else f"{self.value}s"

    @property
    def display_name(self) -> str:
        """Name of this kind in messages to people."""
        return "tissue library" if self is FileKind.LIBRARY else self.value


FILE_MODELS: dict[FileKind, type[GraspProtocol | TissueLibrary | Tool]] = {
    FileKind.PROTOCOL: GraspProtocol,
    FileKind.LIBRARY: TissueLibrary,
    FileKind.TOOL: Tool,
}


def load_settings(path: Path | None = None) -> Settings:
    """Load the service's settings from `path`, or from the shipped `graspwatch.toml`."""
    return load_file(path or CONFIG_DIR / "graspwatch.toml", Settings)


def load_tool(name: str, data_folder: Path | str | None = None) -> Tool:
    """Load a shipped tool, an own one of the data folder, or a tool file by its path."""
    return _load_named(name, FileKind.TOOL, data_folder, Tool)


def load_library(name: str, data_folder: Path | str | None = None) -> TissueLibrary:
    """Load a shipped tissue library, an own one of the data folder, or a library file by its path."""
    return _load_named(name, FileKind.LIBRARY, data_folder, TissueLibrary)


def build_graspable_library(library: TissueLibrary) -> TissueLibrary:
    """Return a library of everything that a simulated grasper can hold: its tissues, and things outside the library."""
    out_of_library = load_library("out_of_library")
    others = {
        name: profile.model_copy(update={"spread": out_of_library.spread_of(name)})
        for name, profile in out_of_library.tissues.items()
        if name not in library.tissues
    }
    return library.model_copy(update={"tissues": {**library.tissues, **others}})


def load_grasp_protocol(name: str, data_folder: Path | str | None = None) -> GraspProtocol:
    """Load a shipped protocol, an own one of the data folder, or a protocol file by its path."""
    return _load_named(name, FileKind.PROTOCOL, data_folder, GraspProtocol)


def list_shipped_names(folder: str) -> list[str]:
    """Return the names of the shipped files in `tools`, `tissues` or `protocols`."""
    return [path.stem for path in list_files(CONFIG_DIR / folder)]


def list_files(folder: Path) -> list[Path]:
    """Return the TOML files of a folder, without hidden ones; none if there is no such folder."""
    return sorted(path for path in folder.glob("*.toml") if not path.name.startswith("."))


def find_file(name: str, kind: FileKind, data_folder: Path | str | None = None) -> Path:
    """Return the path of the file with a name, or of any file by its path (recognized by `/` or `.toml`).

    A shipped file comes before an own one with the same name.

    Raises:
        ConfigurationError: there is no such name.
    """
    if name.endswith(".toml") or "/" in name:
        return Path(expand_home(name))
    files = _list_named(kind, data_folder)
    return files[require_known_name(name, sorted(files), kind.display_name)]


def list_names(kind: FileKind, data_folder: Path | str | None = None) -> list[str]:
    """Return the names of the shipped files and the own ones of the data folder."""
    return sorted(_list_named(kind, data_folder))


def _list_named(kind: FileKind, data_folder: Path | str | None) -> dict[str, Path]:
    own = list_files(Path(data_folder) / kind.folder) if data_folder else []
    return {path.stem: path for path in (*own, *list_files(CONFIG_DIR / kind.folder))}


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


def _load_named(name: str, kind: FileKind, data_folder: Path | str | None, model: type[NamedT]) -> NamedT:
    path = find_file(name, kind, data_folder)
    is_own = data_folder is not None and path.stem == name and path.parent == Path(data_folder) / kind.folder
    if not is_own:
        return load_file(path, model)
    loaded = load_own_file(path, kind)
    assert isinstance(loaded, model)
    return loaded


def load_own_file(path: Path, kind: FileKind) -> GraspProtocol | TissueLibrary | Tool:
    """Parse and validate a file of the data folder, and return its content.

    Raises:
        ConfigurationError: it has faults, or cannot be chosen by its name: a shipped one has this name, or another name
            is in the file. A tool file may have a longer name than its tool, because calibrations add their day.
    """
    loaded = load_file(path, FILE_MODELS[kind])
    if path.stem in list_shipped_names(kind.folder):
        raise ConfigurationError(
            f"{path}: there is a shipped {kind.display_name} {path.stem!r}, which is used instead. Rename the file "
            "and its `name`."
        )
    if kind is not FileKind.TOOL and loaded.name != path.stem:
        raise ConfigurationError(
            f"{path}: the name in the file is {loaded.name!r}, that of the file {path.stem!r}. Give both the same name."
        )
    return loaded


def load_file(path: Path, model: type[ModelT]) -> ModelT:
    """Parse and validate one TOML file, and return its content as `model`.

    Raises:
        ConfigurationError: the file is missing, is not TOML, or has faults; the text lists all faults with their keys.
    """
    return parse_file(read_file_text(path), model, str(path))


def parse_file(text: str, model: type[ModelT], path: str) -> ModelT:
    """Parse and validate the text of a TOML file, and return it as `model`; `path` is its name in messages.

    Raises:
        ConfigurationError: it is not TOML, or has faults; the text lists all faults with their keys.
    """
    try:
        content = tomllib.loads(text.removeprefix(BYTE_ORDER_MARK))
        _check_nesting_depth(content)
        as_json = json.dumps(model.complete(content), default=str)
    except (tomllib.TOMLDecodeError, ValueError) as error:  # ValueError: a number with thousands of digits
        raise ConfigurationError(f"{path}: is not valid TOML: {error}.") from None
    except RecursionError:
        raise ConfigurationError(f"{path}: holds tables within tables without end. Check the file.") from None
    try:  # via JSON, whose strict mode accepts arrays for tuples and strings for enums, but not "5" for 5
        loaded = model.model_validate_json(as_json)
    except ValidationError as error:
        raise ConfigurationError(describe_validation_errors(path, error, model)) from None
    if isinstance(loaded, TissueLibrary):  # not so for those in recordings, which older versions wrote
        check_tissue_names(loaded.tissues, f"{path}: tissues")
        loaded.check_units(path)
        loaded.check_learned(path)
    if isinstance(loaded, Tool):
        check_plausible(loaded, path)
    if isinstance(loaded, GraspProtocol | TissueLibrary | Tool) and len(loaded.name) > MAX_NAME_LENGTH:
        raise ConfigurationError(
            f"{path}: name: has {len(loaded.name)} characters; at most {MAX_NAME_LENGTH} are allowed. Shorten it."
        )
    return loaded


def list_faults(error: ConfigurationError, path: str) -> list[str]:
    """Return the messages of an error of `parse_file`, one a fault, without the file's name."""
    first, *others = str(error).splitlines()
    return [line.removeprefix(f"{path}: ") for line in others or [first]]


def _check_nesting_depth(content: dict[str, Any]) -> None:
    """Raise RecursionError if tables or arrays are nested too deep, as parsers do at their own limit."""
    level: list[Any] = [content]
    for _ in range(MAX_NESTING_DEPTH):
        inside = (each.values() if isinstance(each, dict) else each for each in level)
        level = [value for values in inside for value in values if isinstance(value, dict | list)]
        if not level:
            return
    raise RecursionError


def read_file_text(path: Path) -> str:
    """Return the text of a configuration file.

    Raises:
        ConfigurationError: the file is missing, too long or no text.
    """
    try:
        with path.open(encoding=TEXT_ENCODING) as file:
            text = file.read(MAX_CHARACTERS + 1)
    except FileNotFoundError:
        raise ConfigurationError(f"{path}: there is no such file. Check the path.") from None
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be read ({error.strerror}). Check the path.") from None
    except UnicodeDecodeError:
        raise ConfigurationError(f"{path}: cannot be read as a text file in UTF-8. Save it in that encoding.") from None
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
    loc = fault["loc"][:1] + fault["loc"][2:] if fault["loc"][:1] == ("kinematics",) else fault["loc"]  # without kind
    named = [part for part in loc if part not in UNION_TAGS]
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
