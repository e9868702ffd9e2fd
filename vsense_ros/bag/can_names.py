"""What names of signals say: stems of words in English, German and French, as control units are called.

Names are looked at without capitals, digits and separators. A stem is found anywhere in them, so that compound words
(`Radgeschwindigkeit`, `StrgWhlAng`) need no dictionary of their own.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

WHEEL_SIDES = ("fl", "fr", "rl", "rr")
# What the four wheels are called in one name: front left, front right, rear left, rear right.
SIDES: tuple[tuple[str, str, str, str], ...] = (
    ("frontleft", "frontright", "rearleft", "rearright"),
    ("leftfront", "rightfront", "leftrear", "rightrear"),
    ("frtl", "frtr", "bckl", "bckr"),
    ("frtl", "frtr", "rrl", "rrr"),
    ("frl", "frr", "rel", "rer"),
    ("vornelinks", "vornerechts", "hintenlinks", "hintenrechts"),
    ("avg", "avd", "arg", "ard"),
    ("fl", "fr", "rl", "rr"),
    ("lf", "rf", "lr", "rr"),
    ("vl", "vr", "hl", "hr"),
    ("fl", "fr", "bl", "br"),
    ("lhf", "rhf", "lhr", "rhr"),
    ("fld", "frd", "rld", "rrd"),
)


@dataclass(frozen=True)
class Concept:
    """Words of a quantity, as patterns: all of `needed` must be there, in the signal's name or that of its message; one
    of `helpful` makes it likelier; with one of `excluded` in its name a signal is something else. `quantity` is that
    of `messages.units`."""

    needed: tuple[str, ...]
    helpful: str
    excluded: str
    quantity: str


# A name with one of these is no measurement of motion, whatever else it says.
_NOTHING = (
    "fault|error|valid|check|chk|crc|count|cntr|_cnt|alive|qf$|stat|sta$|diag|request|_rq|rq$|_req|soll|desired|target|"
    "command|cmd|torque|torq|moment|lamp|warn|limit|max$|pedal|puls|_pul_|impuls|encoder|_dir|dirn|direction|press|temp|"
    "enable|active|avail|offset|offst|init|lock|heat|button|cruise|trailer|trlr|radar|lead|consigne|q_?bit|_vz_|vorz|sign$|"
    "mode|display|speedo|distance|accumul|related|regul|gear|gang"
)
_ACCELERATION = "acc|beschl|bschl|_a_|g_sensor|gsensor"
CONCEPTS: Mapping[str, Concept] = MappingProxyType(
    {
        "wheel_speed": Concept(
            ("wheel|whl|roue|rad_?_?ge|rad_?drehz|(?:^|_)ws|rad_?v|v_?rad|rdg",),
            "speed|spd|geschw|gesch|vit|vel|drehz|rpm|roue|_w_|_v_",
            f"{_NOTHING}|accel|slip|schlupf|steer|lenk|dist|position|rate",
            "velocity",
        ),
        "yaw_rate": Concept(
            ("yaw|gier|lacet|psip",),
            "rate|geschw|gesch|_rt|_w_|vit|gier",
            f"{_NOTHING}|acc|nonlin|_lin|stabil|angle|_an_",
            "angular velocity",
        ),
        "steering_wheel": Concept(
            ("steer|strg|lenk|lwi|(?:^|_)lw_|swa|(?:^|_)sas|volant|str_?ang|stw|ste_?wh|ste_?pin|dira",),
            "angle|ang(?:_|$)|winkel|_an_|position|lrw",
            f"{_NOTHING}|rate|speed|geschw|gesch|vit|grd|rough|fraction|_hp|servo|motor|tilt|elev|yaw|rel_?|complement",
            "angle",
        ),
        "lateral_acceleration": Concept(
            ("(?:^|_)(?:lat|quer|trans|y(?:_|$))", _ACCELERATION),
            "lat|quer|trans|_y",
            f"{_NOTHING}|yaw",
            "acceleration",
        ),
        "longitudinal_acceleration": Concept(
            ("(?:^|_)(?:lon|laengs|längs|x(?:_|$))", _ACCELERATION),
            "lon|laengs|längs|_x",
            f"{_NOTHING}",
            "acceleration",
        ),
        "speed": Concept(
            ("speed|spd|geschw|vit|(?:^|_)vel|veh_v",),
            "veh|car|fzg|fahrz|abs|esp|brems|frein",
            f"{_NOTHING}|wheel|whl|rad_|radg|roue|engine|motor|mot_|rpm|shaft|turb|steer|lenk|wind|fan|gps|gnss|relat|"
            "accel|yaw|gier|lenkr|winkel|angle|left|right|inverse|config|speed_sign|left|idle|set|unit|scal",
            "velocity",
        ),
        "gnss": Concept(
            ("gps|gnss|latitude|longitude|breitengrad|laengengrad",),
            "lat|lon|speed|course|heading|breite|laenge",
            "",
            "",
        ),
    }
)
# Messages of cameras, radars and assistants repeat or ask for what others measure.
_SECOND_HAND = re.compile(r"cam|lka|radar|(?:^|_)das|hud|assist|(?:^|_)acc_|navi|lta|ipas|mpc|fcm")


def plain(name: str) -> str:
    """A name in small letters, words divided by underscores, digits taken out."""
    divided = re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "_", name)
    return re.sub(r"_+", "_", re.sub(r"[^a-zäöüßéè]+", "_", divided.lower())).strip("_")


def likeness(concept: str, name: str, message: str) -> float:
    """How much the name of a signal, with that of its message, sounds like a concept: 0 (not at all) to 1."""
    about = CONCEPTS[concept]
    own, whole = f"_{plain(name)}_", f"_{plain(message)}_{plain(name)}_"
    if about.excluded and re.search(about.excluded.replace("$", "_$"), own):
        return 0.0
    if not all(re.search(stem, whole.strip("_")) for stem in about.needed):
        return 0.0
    in_own = all(re.search(stem, own.strip("_")) for stem in about.needed)
    points = 0.6 if in_own else 0.4
    points += 0.4 if re.search(about.helpful, own) else 0.2 if re.search(about.helpful, whole) else 0.0
    return points - 0.2 * bool(_SECOND_HAND.search(plain(message)))


def side_keys(name: str) -> list[tuple[int, str, str]]:
    """The ways in which a name may be that of one wheel: which row of `SIDES`, which wheel, and the rest of the name
    with a star in its place."""
    together = re.sub(r"[^a-zäöü0-9]", "", name.lower())
    together = re.sub(r"\d+", "#", together)
    keys = []
    for row, words in enumerate(SIDES):
        for wheel, word in zip(WHEEL_SIDES, words, strict=True):
            for match in re.finditer(f"(?={word})", together):
                key = f"{together[: match.start()]}*{together[match.start() + len(word) :]}"
                keys.append((row, wheel, key))
    return keys
