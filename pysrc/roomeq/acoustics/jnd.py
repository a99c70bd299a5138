"""Just noticeable differences (JND) of room-acoustic parameters.

ISO 3382-1:2009, table A.1; Bradley et al., Applied Acoustics 58 (1999) 99 (C50); Larsen et al., J. Acoust. Soc. Am. 124
(2008) 450 (DRR).
"""

import math

LEVEL_JND_DB = 1.0
DECAY_JND = math.log(1.05)
"""Of the logarithm of a decay time: 5 %."""
C50_JND_DB = 1.1
DRR_JND_DB = 2.0
