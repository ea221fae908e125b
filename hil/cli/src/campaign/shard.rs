//! Which part of a campaign this machine flies.

/// Part `part` of `parts`, counted from 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Shard {
    pub(super) part: u64,
    pub(super) parts: u64,
}

/// Reads `I/N`; `env/N` or `env`, where the place comes from a job array's variables.
pub(super) fn parse(text: &str) -> Result<Shard, String> {
    parse_with(text, |name| std::env::var(name).ok())
}

fn parse_with(text: &str, variable: impl Fn(&str) -> Option<String>) -> Result<Shard, String> {
    let wrong = || format!("\"{text}\" is no shard: give I/N with I from 0 to N-1, or env/N in a job array");
    let number = |text: &str| text.trim().parse::<u64>().ok();
    let (part, parts) = text.split_once('/').map_or((text, None), |(part, parts)| (part, Some(parts)));
    let parts = match parts {
        Some(parts) => number(parts),
        None if part == "env" => variable("SLURM_ARRAY_TASK_COUNT").as_deref().and_then(number),
        None => None,
    };
    let parts = parts.filter(|parts| *parts > 0).ok_or_else(wrong)?;
    let part = if part == "env" { from_environment(variable)? } else { number(part).ok_or_else(wrong)? };
    if part < parts { Ok(Shard { part, parts }) } else { Err(wrong()) }
}

/// SLURM counts from what the user likes, Kubernetes' indexed jobs from 0.
fn from_environment(variable: impl Fn(&str) -> Option<String>) -> Result<u64, String> {
    let number = |name: &str| variable(name).and_then(|text| text.trim().parse::<u64>().ok());
    if let Some(index) = number("JOB_COMPLETION_INDEX") {
        return Ok(index);
    }
    let first = number("SLURM_ARRAY_TASK_MIN").unwrap_or(0);
    number("SLURM_ARRAY_TASK_ID").and_then(|id| id.checked_sub(first)).ok_or_else(|| {
        "env: neither JOB_COMPLETION_INDEX nor SLURM_ARRAY_TASK_ID is set, so the shard's place is not known".into()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with(text: &str, variables: &[(&str, &str)]) -> Result<Shard, String> {
        let value = |name: &str| {
            variables.iter().find(|(known, _)| *known == name).map(|(_, value)| (*value).to_owned())
        };
        parse_with(text, value)
    }

    #[test]
    fn shard_is_read_from_words_and_from_job_arrays() {
        let third = Ok(Shard { part: 2, parts: 8 });
        assert_eq!(with("2/8", &[]), third);
        assert_eq!(with("env/8", &[("JOB_COMPLETION_INDEX", "2")]), third);
        assert_eq!(with("env/8", &[("SLURM_ARRAY_TASK_ID", "2")]), third);
        let array =
            [("SLURM_ARRAY_TASK_ID", "3"), ("SLURM_ARRAY_TASK_MIN", "1"), ("SLURM_ARRAY_TASK_COUNT", "8")];
        assert_eq!(with("env", &array), third);
    }

    #[test]
    fn shard_that_is_none_is_refused() {
        for wrong in ["8/8", "1/0", "one/2", "3", "env", "-1/4", "/4"] {
            assert!(with(wrong, &[("JOB_COMPLETION_INDEX", "0")]).is_err(), "{wrong}");
        }
        assert!(with("env/4", &[]).unwrap_err().contains("SLURM_ARRAY_TASK_ID"));
    }
}
