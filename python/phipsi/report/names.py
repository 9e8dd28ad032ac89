"""Names of a robot in plots: as they are, whatever characters they have, in fonts that have them; what no font has is spelled out."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

from matplotlib import font_manager, rcParams
from matplotlib.text import Text

#: Longer names would leave no room for the curves.
LONGEST = 36
#: Families that have what DejaVu lacks, tried before all others that are installed.
PREFERRED = (
    "Noto Sans CJK JP", "Noto Sans CJK SC", "Noto Sans CJK KR", "Source Han Sans", "WenQuanYi Micro Hei", "WenQuanYi Zen Hei",
    "Droid Sans Fallback", "IPAexGothic", "Hiragino Sans", "PingFang SC", "Apple SD Gothic Neo", "Microsoft YaHei", "Yu Gothic",
    "Malgun Gothic", "Noto Emoji", "Symbola", "Segoe UI Symbol", "Unifont",
)  # fmt: skip
#: Fonts that have pictures or boxes for everything, which is no help.
UNUSABLE = ("color", "last resort", "lastresort")


def write_names(texts: Sequence[Text], names: Sequence[Sequence[str]]) -> None:
    """Puts names into each text, one a line: no mathematics in them, no box, nothing that the plotting library warns of."""
    default = [str(family) for family in rcParams["font.family"]]
    families = (*default, *_families("".join(name for lines in names for name in lines), tuple(default)))
    for text, lines in zip(texts, names, strict=True):
        text.set_parse_math(False)
        text.set_fontfamily(families)
        text.set_text("\n".join(readable(shortened(name), families) for name in lines))


def shortened(name: str) -> str:
    """A name that leaves room for what it names: long ones without their middle."""
    return name if len(name) <= LONGEST else f"{name[: LONGEST - 13]}…{name[-12:]}"


def readable(name: str, families: Sequence[str]) -> str:
    """The name with the characters that none of the families has written as in Python, such as \\u81c2."""
    return "".join(c if _is_known(c, tuple(families)) else c.encode("unicode_escape").decode("ascii") for c in name)


def _is_known(character: str, families: tuple[str, ...]) -> bool:
    return character.isprintable() and any(_has(family, character) for family in families)


def _families(characters: str, default: tuple[str, ...]) -> list[str]:
    """Installed families that have what the default ones lack, as few as are needed."""
    lacking = {c for c in characters if c.isprintable() and not any(_has(family, c) for family in default)}
    # Upright and of usual weight: others would be taken for want of these, with a message.
    fonts = (font for font in font_manager.fontManager.ttflist if font.style == "normal" and font.weight in (400, "normal"))
    installed = {font.name for font in fonts if not any(word in font.name.lower() for word in UNUSABLE)}
    found: list[str] = []
    for family in (*(one for one in PREFERRED if one in installed), *sorted(installed.difference(PREFERRED))):
        # None of them is looked into where nothing is lacking.
        had = {c for c in lacking if _has(family, c)}
        if had:
            found.append(family)
            lacking -= had
    return found


@lru_cache(maxsize=None)
def _has(family: str, character: str) -> bool:
    """Whether the font that the plotting library takes for a family has a character."""
    try:
        path = font_manager.findfont(font_manager.FontProperties(family=[family]), fallback_to_default=True)
        return bool(font_manager.get_font(path).get_char_index(ord(character)))
    except (OSError, RuntimeError, ValueError):
        # A font of pictures, or one that was removed.
        return False
