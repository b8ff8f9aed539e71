"""From pictures to a settings file: what ``magtrak learn-gate`` does."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from .errors import LearnError, OutputError
from .gate import Spans
from .learn import Sample, from_pair, from_patch, learn, read_picture, share
from .reference import luts_from_words
from .settings import Gate
from .settings_file import load_values, parse_settings


def learn_gate(
    *,
    picture: Path | None,
    patch: tuple[int, int, int, int] | None,
    on: Path | None,
    off: Path | None,
    output: Path,
    settings: str,
) -> None:
    """Options as in ``magtrak learn-gate --help``; :exc:`MagtrakError` in one sentence where they can't be."""
    base = load_values(settings)
    parse_settings(base, settings)
    sample = _sample(picture, patch, on, off)
    values = base | {"gate": _table(learn(sample))}
    # What is told is what the file says.
    words = parse_settings(values, str(output)).tables()
    luts = luts_from_words([table for _, table in words])
    line, others = (100 * share(pixels, luts) for pixels in (sample.line, sample.others))
    told = (
        f"of the line {line:.1f} % of {len(sample.line)} pixels pass,"
        f" of the rest {others:.1f} % of {len(sample.others)}"
    )
    source = f"{on.name} and {off.name}" if on and off else f"{picture.name if picture else ''}, patch {patch}"
    text = f"# Gate learned from {source}:\n# {told}. All else is as in {Path(settings).name}.\n" + toml(values)
    try:
        output.write_text(text, encoding="utf-8")
    except OSError as error:
        raise OutputError(f"{output} cannot be written: {error.strerror}") from None
    print(f"{output}: {told}")


def _sample(picture: Path | None, patch: tuple[int, int, int, int] | None, on: Path | None, off: Path | None) -> Sample:
    if picture is not None and patch is not None and on is None and off is None:
        return from_patch(read_picture(picture), *patch)
    if on is not None and off is not None and picture is None and patch is None:
        return from_pair(read_picture(on), read_picture(off))
    raise LearnError("give either --picture FILE with --patch X Y W H, or --on FILE with --off FILE")


def _table(gate: Gate) -> dict[str, object]:
    def short(spans: Spans) -> list[Any]:
        """A single range stands for itself."""
        ranges = [list(span) for span in spans]
        return ranges if len(ranges) > 1 else ranges[0]

    return {name: short(getattr(gate, name)) for name in ("hue", "luminance", "saturation")}


def toml(values: Mapping[str, Mapping[str, object]]) -> str:
    """Tables of numbers, truths, texts and lists of them. JSON writes such values as TOML does."""
    return "".join(
        f"\n[{name}]\n" + "".join(f"{key} = {json.dumps(value)}\n" for key, value in table.items())
        for name, table in values.items()
    )
