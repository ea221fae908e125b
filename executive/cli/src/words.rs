//! Guesses what a mistyped word was meant to be.

/// Share of letters that agree, from where on a guess helps more than it misleads.
const LIKENESS: f64 = 0.6;

/// The candidate that a word most likely meant.
pub fn nearest<'c>(word: &str, candidates: impl IntoIterator<Item = &'c str>) -> Option<&'c str> {
    let like = |candidate: &str| strsim::normalized_damerau_levenshtein(word, candidate);
    let scored = candidates.into_iter().map(|candidate| (like(candidate), candidate));
    let best = scored.max_by(|a, b| a.0.total_cmp(&b.0))?;
    (best.0 >= LIKENESS).then_some(best.1)
}
