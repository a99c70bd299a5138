"""Sentences of the synthetic speech corpus, in an artificial language of English words.

Each word is drawn from a mixture of four conditional distributions, given the last three, two, one and no words, and
a uniform distribution. So perplexity falls with the order of an n-gram model, up to 4-grams.
"""

from functools import cache

import numpy as np
import numpy.typing as npt

from roomeq.core.rng import rng_for

VOCABULARY = """zero one two three four five six seven eight nine ten yes no up down left right on off stop go open shut
turn play call find show wait run sing walk take make bring give send lamp door window kitchen garden table chair bed
floor wall room key water coffee tea bread cake milk butter apple pear sugar salt wine river mountain lake ocean forest
tree flower grass rain snow sun moon star cloud fire stone sand cat dog horse mouse sheep goat bear bird fish lion hand
foot head arm doctor teacher mother father sister brother king queen man men boy girl pen paper letter book coat hat
boat ship train car bridge street road market school church town city ball ring spoon box bag bat clock music song story
game name yellow orange purple silver red green blue black white brown gold light bright cold warm long short small big
old new late early happy quiet morning evening night summer winter day week""".split()
LENGTHS = 3, 10  # fewest and most words of a sentence
SHARES = 0.25, 0.35, 0.25, 0.1, 0.05  # weights of the distributions given three, two, one, no words; of the uniform one
EXPONENTS = 2.5, 2.5, 2.0, 0.7  # exponents of Zipf's law for the four conditional distributions


ZIPF = [np.cumsum(np.arange(1, len(VOCABULARY) + 1.0) ** -exponent) for exponent in EXPONENTS]


@cache
def ranking(seed: int, *context: str) -> npt.NDArray[np.uint8]:
    """Return indices into `VOCABULARY`, from the most to the least likely word after the words of `context`."""
    order = rng_for(seed, "standin-language", " ".join(context)).permutation(len(VOCABULARY))
    return order.astype(np.uint8)


def draw_sentence(seed: int, rng: np.random.Generator) -> list[str]:
    """Return the words of a sentence.

    Parameters
    ----------
    seed
        Seed of the language.
    rng
        Generator for the sentence.
    """
    words = ["<s>"] * len(ZIPF)
    n_words = int(rng.integers(LENGTHS[0], LENGTHS[1] + 1))
    for component_u, word_u in rng.random((n_words, 2)):
        component = int(np.searchsorted(np.cumsum(SHARES), component_u * sum(SHARES), side="right"))
        if component < len(ZIPF):
            rank = np.searchsorted(ZIPF[component], word_u * ZIPF[component][-1], side="right")
            words.append(VOCABULARY[ranking(seed, *words[len(words) - len(ZIPF) + 1 + component:])[rank]])
        else:
            words.append(VOCABULARY[int(word_u * len(VOCABULARY))])
    return words[len(ZIPF):]
