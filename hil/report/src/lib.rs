//! What a flight is turned into: scores, plots, one HTML page.
