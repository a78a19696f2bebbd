"""Settings from ``--config FILE.toml`` and ``--set name=value`` into checked dataclasses."""

from __future__ import annotations

import dataclasses
import inspect
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, get_type_hints

from pydantic import TypeAdapter, ValidationError

from foldlab.errors import InputError


def read_settings(pairs: Iterable[str] = (), config: Path | None = None) -> dict[str, Any]:
    """Names to values; a pair wins over the file.

    Values are read as TOML (``0.1``, ``true``, ``[1, 2]``), else kept as text. Raises
    :class:`InputError` for a pair without '=', a missing file or a file that is not TOML.
    """
    settings: dict[str, Any] = {}
    if config is not None:
        try:
            settings.update(tomllib.loads(Path(config).read_text(encoding="utf-8")))
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(f"can't read the settings {config} ({error})") from None
        except tomllib.TOMLDecodeError as error:
            raise InputError(f"{config} is not TOML: {error}; write lines name = value") from None
    for pair in pairs:
        name, equals, text = pair.partition("=")
        if not equals or not name.strip():
            raise InputError(f"--set {pair}: expected name=value, as in --set slenderness=0.01")
        settings[name.strip()] = _value(text.strip())
    return settings


def _value(text: str) -> Any:
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        try:
            # TOML refuses what people type: .5, 1., 007, nan
            return float(text)
        except ValueError:
            return text


def build(cls: type, settings: dict[str, Any], **fixed: Any):
    """An instance of the dataclass ``cls`` from settings, types checked and converted.

    Those that are ``fixed`` are not the user's to set. Raises :class:`InputError` that names an
    unknown field and those there are, or a wrong value.
    """
    fields = {field.name for field in dataclasses.fields(cls)} - fixed.keys()
    for name in settings:
        if name not in fields:
            raise InputError(f"no setting {name!r}; there are: {', '.join(sorted(fields))}")
    try:
        return TypeAdapter(cls).validate_python({**settings, **fixed})
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"]) or cls.__name__
        raise InputError(f"{where} = {first['input']!r}: {_reason(error)}") from None


def call(cls: type, settings: Mapping[str, Any], *, what: str, **fixed: Any):
    """``cls(**settings, **fixed)``, the settings checked and converted as its constructor says.

    Where a parameter is itself a record of settings, a dataclass whose fields all have defaults,
    its fields are settings too. ``what`` names ``cls`` in messages. Raises :class:`InputError` for
    a setting that it lacks or that is not the user's to give, and for a value of a wrong type.
    """
    parameters = inspect.signature(cls).parameters
    hints = get_type_hints(cls.__init__)
    names = [name for name in parameters if name not in fixed]
    records = {name: hints[name] for name in names if _is_record(hints.get(name))}
    fields = {f.name: name for name, record in records.items() for f in dataclasses.fields(record)}
    names = [name for name in names if name not in records]
    needed = [name for name in names if parameters[name].default is inspect.Parameter.empty]
    missing = [name for name in needed if name not in settings]
    values = {}
    parts: dict[str, dict[str, Any]] = {name: {} for name in records}
    for name, value in settings.items():
        if name not in names and name not in fields:
            known = ", ".join([*fields, *names])
            raise InputError(f"{what} has no setting {name!r}; it has: {known}")
        record = fields.get(name)
        hint = hints.get(name, Any) if record is None else get_type_hints(records[record])[name]
        try:
            checked = TypeAdapter(hint).validate_python(value)
        except ValidationError as error:
            raise InputError(f"{name} = {value!r}: {_reason(error)}") from None
        (values if record is None else parts[record])[name] = checked
    if missing:
        raise InputError(f"{what} needs {', '.join(missing)}; add --set {missing[0]}=…")
    made = {name: records[name](**part) for name, part in parts.items() if part}
    return cls(**values, **made, **fixed)


def _is_record(hint) -> bool:
    """Whether it is a dataclass whose fields all have defaults."""
    if not (isinstance(hint, type) and dataclasses.is_dataclass(hint)):
        return False
    return all(
        f.default is not dataclasses.MISSING or f.default_factory is not dataclasses.MISSING
        for f in dataclasses.fields(hint)
    )


def changed(record: Any) -> list[str]:
    """Name and value of each field of a dataclass that is not its default, for a version's text."""
    pairs = ((f, getattr(record, f.name)) for f in dataclasses.fields(record))
    return [f"{f.name}{value}" for f, value in pairs if value != f.default]


def _reason(error: ValidationError) -> str:
    return error.errors()[0]["msg"].removeprefix("Value error, ")
