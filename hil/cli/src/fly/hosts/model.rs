//! What a modelled network does, as the command line says it.

use std::collections::BTreeSet;

use anyhow::{Result, bail};
use bateleur_contract::relay::{CutTable, LinkModelTable};
use bateleur_plan::units;

use super::super::Arguments;

/// `--link`, with the flight's seed where it names none.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct LinkModel {
    table: LinkModelTable,
    seed: Option<u64>,
}

/// A network that is cut for a while of module time.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Cut {
    /// Its name in the plan.
    pub(crate) network: String,
    /// From then on, s.
    pub(crate) from_s: f64,
    /// Until then, s.
    pub(crate) until_s: f64,
}

/// A host that is killed.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Death {
    /// Its module.
    pub(crate) module: String,
    /// At this module time, s.
    pub(crate) at_s: f64,
    /// It is started anew at this one, s.
    pub(crate) back_s: Option<f64>,
}

pub(crate) fn parse(text: &str) -> Result<LinkModel, String> {
    let mut model = LinkModel { table: LinkModelTable::default(), seed: None };
    let mut said = BTreeSet::new();
    for word in text.split(',') {
        let (key, value) =
            word.split_once('=').ok_or_else(|| format!("\"{word}\" is not KEY=VALUE, such as loss=0.05"))?;
        if !said.insert(key.trim()) {
            return Err(format!("{} is said twice: say it once", key.trim()));
        }
        set(&mut model, key.trim(), value.trim()).map_err(|why| format!("{key}={value}: {why}"))?;
    }
    if model.table.reorder > 0.0 && model.table.reorder_ns == 0 {
        return Err(
            "reorder needs reorder_by: how long those are held up, such as reorder_by=20ms".to_owned()
        );
    }
    Ok(model)
}

fn set(model: &mut LinkModel, key: &str, value: &str) -> Result<(), String> {
    let table = &mut model.table;
    let time = || units::duration_ns(value).map_err(|error| error.to_string());
    let share = || {
        let share = value.parse::<f64>().ok().filter(|share| (0.0..=1.0).contains(share));
        share.ok_or_else(|| "it is no share from 0 to 1".to_owned())
    };
    match key {
        "delay" => table.delay_ns = time()?,
        "jitter" => table.jitter_ns = time()?,
        "loss" => table.loss = share()?,
        "duplicate" => table.duplicate = share()?,
        "reorder" => table.reorder = share()?,
        "reorder_by" => table.reorder_ns = time()?,
        "bandwidth" => {
            table.rate_bps = units::rate_bits_per_s(value).map_err(|error| error.to_string())?;
            // The model takes it for "as quick as can be".
            if table.rate_bps == 0 {
                return Err(
                    "nothing would pass: loss=1 says that; without a bandwidth there is no limit".to_owned()
                );
            }
        }
        "seed" => model.seed = Some(value.parse().map_err(|_| "it is no whole number".to_owned())?),
        _ => {
            return Err(
                "there is delay, jitter, loss, duplicate, reorder, reorder_by, bandwidth and seed".to_owned()
            );
        }
    }
    Ok(())
}

pub(crate) fn parse_cut(text: &str) -> Result<Cut, String> {
    let wrong = || format!("\"{text}\" is not NETWORK@FROM-UNTIL, such as a@100-120");
    let (network, span) = text.split_once('@').ok_or_else(wrong)?;
    let (from, until) = span.split_once('-').ok_or_else(wrong)?;
    let seconds = |text: &str| text.parse::<f64>().ok().filter(|s| s.is_finite() && *s >= 0.0);
    match (seconds(from), seconds(until)) {
        (Some(from_s), Some(until_s)) if from_s < until_s => {
            Ok(Cut { network: network.to_owned(), from_s, until_s })
        }
        _ => Err(wrong()),
    }
}

pub(crate) fn parse_kill(text: &str) -> Result<Death, String> {
    let death = text.split_once('@').and_then(|(module, times)| {
        let (at, back) = times.split_once('-').map_or((times, None), |(at, back)| (at, Some(back)));
        let seconds = |text: &str| text.parse::<f64>().ok().filter(|s| s.is_finite() && *s >= 0.0);
        let (at_s, back_s) = (seconds(at)?, back.map(seconds));
        let is_later = back_s.is_none_or(|back_s| back_s.is_some_and(|back_s| at_s < back_s));
        is_later.then(|| Death { module: module.to_owned(), at_s, back_s: back_s.flatten() })
    });
    death.ok_or_else(|| {
        format!(
            "\"{text}\" is not MODULE@SECONDS, such as nav@100, nor MODULE@FROM-UNTIL, such as nav@100-105"
        )
    })
}

/// The attribute of every relay of the flight.
pub(super) fn table(arguments: &Arguments) -> Result<serde_json::Value> {
    let asked = arguments.hosts.link.clone();
    let mut table = asked.as_ref().map_or_else(LinkModelTable::default, |model| model.table.clone());
    table.seed = asked.and_then(|model| model.seed).unwrap_or(arguments.seed);
    let nanoseconds = |seconds: f64| (seconds * 1e9) as u64;
    table.cuts = arguments
        .hosts
        .cut
        .iter()
        .map(|cut| CutTable {
            network: cut.network.clone(),
            from_ns: nanoseconds(cut.from_s),
            until_ns: nanoseconds(cut.until_s),
        })
        .collect();
    match serde_json::to_value(&table) {
        Ok(value) => Ok(value),
        Err(error) => bail!("cannot write down the model of the links: {error}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_model_is_read_with_its_units() {
        let model = parse("delay=2ms, jitter=5ms,loss=0.05,bandwidth=10Mbit/s,seed=7").unwrap();
        let table = &model.table;
        assert_eq!((table.delay_ns, table.jitter_ns, table.rate_bps), (2_000_000, 5_000_000, 10_000_000));
        assert_eq!((table.loss, model.seed), (0.05, Some(7)));
    }

    #[test]
    fn what_is_no_model_is_refused_with_the_word() {
        for (text, why) in [
            ("loss=5", "no share"),
            ("delay=5", "unit"),
            ("los=0.1", "there is delay"),
            ("loss", "KEY=VALUE"),
            ("reorder=0.1", "reorder_by"),
            ("bandwidth=0bit/s", "nothing would pass"),
            ("loss=0.1, loss=0.9", "loss is said twice"),
        ] {
            let error = parse(text).unwrap_err();
            assert!(error.contains(why), "{text}: {error}");
        }
        for text in ["a@5", "a@7-5", "5-7", "a@-1-5"] {
            assert!(parse_cut(text).is_err(), "{text}");
        }
        assert_eq!(parse_cut("a@5-7.5").unwrap().until_s, 7.5);
        for text in ["nav", "nav@x", "nav@5-5", "nav@5-", "nav@5-x", "nav@-1"] {
            assert!(parse_kill(text).is_err(), "{text}");
        }
        assert_eq!(parse_kill("nav@5").unwrap().back_s, None);
        let death = parse_kill("nav@5-7.5").unwrap();
        assert_eq!((death.module.as_str(), death.at_s, death.back_s), ("nav", 5.0, Some(7.5)));
    }
}
