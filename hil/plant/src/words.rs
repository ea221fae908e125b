//! Guesses what a mistyped word was meant to be.

/// Share of letters that agree, from where on a guess helps more than it misleads.
const LIKENESS: f64 = 0.6;

/// The sentence for a word that is none of the candidates.
pub(crate) fn unknown<'c>(
    what: &str,
    word: &str,
    candidates: impl Iterator<Item = &'c str> + Clone,
) -> String {
    match nearest(word, candidates.clone()) {
        Some(near) => format!("there is no {what} `{word}`: did you mean `{near}`?"),
        None => {
            let all: Vec<&str> = candidates.collect();
            format!("there is no {what} `{word}`: choose one of {}", all.join(", "))
        }
    }
}

/// The candidate that a word most likely meant.
pub(crate) fn nearest<'c>(word: &str, candidates: impl Iterator<Item = &'c str>) -> Option<&'c str> {
    let scored =
        candidates.map(|candidate| (strsim::normalized_damerau_levenshtein(word, candidate), candidate));
    let best = scored.max_by(|a, b| a.0.total_cmp(&b.0))?;
    (best.0 >= LIKENESS).then_some(best.1)
}
