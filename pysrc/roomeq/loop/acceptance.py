"""Decide whether a candidate is added to the model: what its rendering changes in the held-out error.

The error of the features that the effect touches must fall on both `SPLITS`, by `_MIN_FALL` in the mean of both and
significantly (Fisher's method, which combines both p values; at `_JOINT_LEVEL`): the scatter of the others would hide
an effect that touches few. Features count as much as they tell of the effect (`roomeq.loop.selection.weights_of`): in a
mean over metrics, the few decay times at low frequencies, which scatter most, would decide about room modes; in a mean
over features, the many that hardly change would decide about the speed of sound. The error of all features must not
rise significantly on any split. An effect whose predicted error hardly falls is not rendered (`judge_predicted`).

An equaliser, which names no cause and is the same in all rooms, needs significance on each split, and in rooms with
other devices than those that it was fitted to, whose response it may be. What was read off the recordings has no other
cause: it is enough that the error does not rise by more than `_TOLERATED_JND`.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc

from roomeq.core.arrays import FloatArray
from roomeq.effects.base import Effect
from roomeq.loop.heldout_errors import (
    SPLITS,
    HeldOutErrors,
    p_lower,
    p_with_other_devices,
    predicted_errors,
    share_of_fall,
)
from roomeq.loop.selection import LEVEL, weights_of
from roomeq.loop.session import Session

RISES, OTHER_DEVICES, NO_CLEAR_FALL = "error rises", "not in rooms with other devices", "no clear fall"
REASONS = (RISES, OTHER_DEVICES, NO_CLEAR_FALL)
"""Why a candidate is rejected."""
_TOLERATED_JND = 0.05
"""Rise of the held-out error that is taken for chance: noise scatters, also in rooms that have hardly any."""
_JOINT_LEVEL = 0.01
"""Level of Fisher's test of both `SPLITS`, which assumes that they are independent. They share rooms and recordings;
were both to show the same, p values of 3.6 % would be enough."""
_MIN_FALL = 0.03
"""Smallest fall of the held-out error that counts, as a share of the error of the features that an effect touches, in
the mean over `SPLITS`. The scattering coefficient is unknown: with 0.15 or 0.5 in its place, the error of all features
of ten generated sets changed by 2 % and 5 % in the mean. An effect that changes what it touches by less may be the
wrong scattering."""


class Trial(NamedTuple):
    """What a candidate changes in the error of the features that it touches.

    Attributes
    ----------
    p, falls : dict
        By split: p value of a lower error (`roomeq.loop.heldout_errors.p_lower`), and the fall as a share of the error.
    joint_p : float
        p value of both splits, by Fisher's method.
    other_devices_p : float or None
        p value in rooms with other devices; None where it is not asked.
    reason : str or None
        Of `REASONS`, why the candidate is rejected; None if it is accepted.
    rendered : bool
        Whether the errors are those of renderings, or predicted.
    """

    p: dict[str, float]
    falls: dict[str, float]
    joint_p: float
    other_devices_p: float | None
    reason: str | None
    rendered: bool


def judge_predicted(effect: type[Effect], errors: Callable[[], HeldOutErrors], after: Session) -> Trial | None:
    """Return the trial of an effect that its prediction rejects, or None if it is to be rendered.

    It is rejected if the predicted error of what it touches falls by too little. Whether a fall is significant is left
    to rendering, as is all that is read off the recordings. Predictions hardly scatter, so that tiny rises of the error
    of all features are significant: those up to `_TOLERATED_JND` do not count.

    Parameters
    ----------
    effect : type
    errors : callable
        Returns the predicted errors without the effect.
    after : Session
        With the effect.
    """
    if effect.MEASURED:
        return None
    before, errors_after = errors(), predicted_errors(after)
    trial = _compare(before, errors_after, weights_of(effect, after))._replace(rendered=False)
    if np.mean([*trial.falls.values()]) > _MIN_FALL:
        return None
    rises = _rises(before, errors_after) and not _is_tolerated(before, errors_after)
    return trial._replace(reason=RISES if rises else NO_CLEAR_FALL)


def judge(effect: type[Effect], before: Session, after: Session, errors: HeldOutErrors, errors_after: HeldOutErrors
          ) -> Trial:
    """Return what an effect changes, which one of two sessions has, and whether it is accepted.

    Parameters
    ----------
    effect : type
    before, after : Session
        Without and with the effect.
    errors, errors_after : HeldOutErrors
        Of both.
    """
    weights = weights_of(effect, after)
    trial = _compare(errors, errors_after, weights)
    if effect.MEASURED:
        return trial if _is_tolerated(errors, errors_after) else trial._replace(reason=RISES)
    if _rises(errors, errors_after):
        return trial._replace(reason=RISES)
    significant = trial.joint_p < _JOINT_LEVEL if effect.NAMES_CAUSE else max(trial.p.values()) < LEVEL
    falls = [*trial.falls.values()]
    if not significant or min(falls) <= 0.0 or np.mean(falls) <= _MIN_FALL:
        return trial._replace(reason=NO_CLEAR_FALL)
    if effect.NAMES_CAUSE:
        return trial
    other_devices_p = p_with_other_devices(before, after, weights)  # renders both again
    return trial._replace(other_devices_p=other_devices_p, reason=OTHER_DEVICES if other_devices_p >= LEVEL else None)


def _compare(errors: HeldOutErrors, errors_after: HeldOutErrors, weights: FloatArray) -> Trial:
    """Return the trial of an effect from errors without and with it, and `weights_of` it; nothing is decided."""
    p = {split: p_lower(errors, errors_after, split, weights) for split in SPLITS}
    falls = {split: share_of_fall(errors, errors_after, split, weights) for split in SPLITS}
    return Trial(p, falls, _joint_p([*p.values()]), None, None, True)


def _joint_p(p: list[float]) -> float:
    """Return the p value of all tests together (Fisher, Statistical Methods for Research Workers, sec. 21.1)."""
    return float(chdtrc(2 * len(p), -2.0 * np.log(p).sum()))


def _rises(errors: HeldOutErrors, errors_after: HeldOutErrors) -> bool:
    """Tell whether the error of all features rises significantly on one of the splits."""
    return any(p_lower(errors_after, errors, split) < LEVEL for split in SPLITS)


def _is_tolerated(errors: HeldOutErrors, errors_after: HeldOutErrors) -> bool:
    """Tell whether the error of all features rises by less than `_TOLERATED_JND` on both splits."""
    return all(errors_after.mean(split) < errors.mean(split) + _TOLERATED_JND for split in SPLITS)


def describe_rejection(trial: Trial) -> str:
    """Say why a trial is rejected."""
    error = f"{'rendered' if trial.rendered else 'predicted'}, the held-out error"
    if trial.reason == RISES:
        return f"{error} rises"
    if trial.reason == OTHER_DEVICES:
        return f"{error} does not fall significantly in rooms with other devices (p {trial.other_devices_p:.2g})"
    return f"{error} of what it touches falls too little or not significantly: " + ", ".join(
        f"by {100 * trial.falls[split]:.0f} % (p {trial.p[split]:.2g}, {split.replace('_', '-')})" for split in SPLITS)
