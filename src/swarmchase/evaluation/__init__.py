"""Controllers through many chases: tables of chases, statistics, comparisons, the reproduction of the paper."""
