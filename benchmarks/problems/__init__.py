"""Problems with answers in closed form; a new one is one more entry of `PROBLEMS`."""

from .blocks import BLOCKS
from .masonry import MASONRY
from .solids import SOLIDS

PROBLEMS = {problem.name: problem for problem in [*BLOCKS, *SOLIDS, *MASONRY]}
