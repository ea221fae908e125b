//! Holds a trace against the description of the trace event format. Tests of other packages take it in by its path: it must
//! know nothing of this one.

use std::collections::{BTreeMap, BTreeSet};

use serde_json::Value;

/// What the description of the trace event format asks of every event and of the whole; with the number of events of each
/// phase.
pub(crate) fn assert_trace(text: &str) -> BTreeMap<String, usize> {
    let trace: Value = serde_json::from_str(text).unwrap();
    assert!(["ms", "ns"].contains(&trace["displayTimeUnit"].as_str().unwrap()));
    let (mut phases, mut tracks, mut named) = (BTreeMap::new(), BTreeMap::new(), BTreeSet::new());
    for event in trace["traceEvents"].as_array().unwrap() {
        let number = |key: &str| event[key].as_f64().unwrap_or_else(|| panic!("no {key} in {event}"));
        let track = (event["pid"].as_u64().unwrap(), event["tid"].as_u64().unwrap());
        assert!(!event["name"].as_str().unwrap().is_empty(), "{event}");
        let args = &event["args"];
        assert!(args.is_null() || args.is_object(), "{event}");
        let phase = event["ph"].as_str().unwrap();
        *phases.entry(phase.to_owned()).or_default() += 1;
        match phase {
            "M" => {
                let kind = event["name"].as_str().unwrap();
                assert!(["process_name", "thread_name"].contains(&kind), "{event}");
                assert!(args["name"].is_string(), "{event}");
                assert!(named.insert((kind.to_owned(), track)), "named twice: {event}");
            }
            "X" => {
                assert!(number("ts") >= 0.0 && number("dur") >= 0.0, "{event}");
                tracks.entry(track).or_insert_with(Vec::new).push((number("ts"), number("dur")));
            }
            "i" => {
                assert!(number("ts") >= 0.0, "{event}");
                let reach = event["s"].as_str().unwrap();
                assert!(["g", "p", "t"].contains(&reach), "{event}");
                if reach == "t" {
                    assert!(named.contains(&("thread_name".to_owned(), track)), "on no track: {event}");
                }
            }
            other => panic!("phase {other} needs a partner that nothing here checks: {event}"),
        }
    }
    for (track, mut spans) in tracks {
        assert!(named.contains(&("thread_name".to_owned(), track)), "a track without a name: {track:?}");
        assert!(named.iter().any(|(kind, (pid, _))| kind == "process_name" && *pid == track.0));
        // Spans of one track lie one after the other: viewers put what overlaps below each other, or drop it.
        spans.sort_by(|a, b| a.0.total_cmp(&b.0));
        let in_turn = spans.windows(2).all(|pair| pair[0].0 + pair[0].1 <= pair[1].0 + 1e-3);
        assert!(in_turn, "spans of track {track:?} overlap: {spans:?}");
    }
    phases
}
