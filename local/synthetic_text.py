"""What the synthetic speech corpus says: sentences of a made-up language of English words.

The next word is drawn from a mixture of preferences, given the last three words, two, one, and none: so a bigram model
knows more than a unigram model, a trigram model more than that, and a 4-gram model a little more again.
"""

from functools import cache

import numpy as np

from roomeq.core.rng import rng_for

VOCABULARY = """zero one two three four five six seven eight nine ten yes no up down left right on off stop go open shut
turn play call find show wait run sing walk take make bring give send lamp door window kitchen garden table chair bed
floor wall room key water coffee tea bread cake milk butter apple pear sugar salt wine river mountain lake ocean forest
tree flower grass rain snow sun moon star cloud fire stone sand cat dog horse mouse sheep goat bear bird fish lion hand
foot head arm doctor teacher mother father sister brother king queen man men boy girl pen paper letter book coat hat
boat ship train car bridge street road market school church town city ball ring spoon box bag bat clock music song story
game name yellow orange purple silver red green blue black white brown gold light bright cold warm long short small big
old new late early happy quiet morning evening night summer winter day week""".split()
LENGTHS = 3, 10  # words of a sentence
SHARES = 0.25, 0.35, 0.25, 0.1, 0.05  # of preferences given three, two, one, no words; of no preference
EXPONENTS = 2.5, 2.5, 2.0, 0.7  # of Zipf's law, for each of the preferences


ZIPF = [np.cumsum(np.arange(1, len(VOCABULARY) + 1.0) ** -exponent) for exponent in EXPONENTS]


@cache
def favourites(seed, *context):
    """Return the places of the words in `VOCABULARY`, from the likeliest after some words to the least likely."""
    order = rng_for(seed, "standin-language", " ".join(context)).permutation(len(VOCABULARY))
    return order.astype(np.uint8)


def draw_sentence(seed, rng):
    """Return the words of a sentence.

    Parameters
    ----------
    seed : int
        Of the language.
    rng : numpy.random.Generator
        Of the sentence.
    """
    words = ["<s>"] * len(ZIPF)
    n_words = int(rng.integers(LENGTHS[0], LENGTHS[1] + 1))
    for preference, chance in rng.random((n_words, 2)):
        which = int(np.searchsorted(np.cumsum(SHARES), preference * sum(SHARES), side="right"))
        if which < len(ZIPF):
            rank = np.searchsorted(ZIPF[which], chance * ZIPF[which][-1], side="right")
            words.append(VOCABULARY[favourites(seed, *words[len(words) - len(ZIPF) + 1 + which:])[rank]])
        else:
            words.append(VOCABULARY[int(chance * len(VOCABULARY))])
    return words[len(ZIPF):]
