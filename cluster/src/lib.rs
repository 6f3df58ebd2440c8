//! Ranks, exchange plans and reductions: how the parts of a run talk to each other.
