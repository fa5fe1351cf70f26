"""The report's terms and policies in words, for readers who know roads but not this simulator."""

from collections.abc import Iterable

from medjax.render.story import words_for
from train.evaluation.tables import SAMPLED, START

TERMS = {
    "EV": "an electric vehicle.",
    "MED": "a mobile energy disseminator: a truck with a large battery that charges EVs as all of them drive. The "
    "fleet is small, and each MED enters at a ramp.",
    "episode": "one simulated stretch of time. Every policy plays the same episodes, with the same vehicles arriving.",
    "policy": "what decides when to send a MED, and from which ramp.",
    "baseline": "a policy that was not learned, beside which the learner is judged: each of the rules below.",
    "best rule": "of the rules that send MEDs, the one with the highest mean return.",
    "return": "the sum of an episode's rewards, which learning increases: higher is better. The settings at the end of "
    "this page name its parts.",
    "depleted": "with an empty battery. A depleted EV stops at the roadside and has to be towed. The depleted share is "
    "that of all EVs that were on the road in the episode.",
    "reach their exit": "drive to the end of their trip with energy left. EVs still on the road when the episode ends "
    "do not count.",
    "time lost": "compared with driving at the speed that each driver wants.",
}
"""What each term means."""

START_WORDS = "The policy that learning starts from."
SAMPLED_WORDS = (
    "Draws its actions by their probabilities, where the others take the most probable one."
)


def policies_in_words(names: Iterable[str]) -> dict[str, str]:
    """A sentence on each policy of a report, by name."""
    said = {}
    for name in names:
        base = name.removesuffix(SAMPLED)
        words = START_WORDS if base == START else words_for(base)
        said[name] = f"{words} {SAMPLED_WORDS}" if name != base else words
    return said
