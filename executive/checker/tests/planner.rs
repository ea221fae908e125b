//! The planner: what it answers holds, and it finds what was there to find.

// A test may be blunt: a panic is how it fails.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod plan_support;

use std::fmt::Write;

use bateleur_checker::planner::{Answer, Bound, Impossible, Need, Request, plan};
use plan_support::answer_to;
use proptest::prelude::*;

const US: u64 = 1_000;
const MS: u64 = 1_000_000;

fn need(name: &str, period_ms: u64, duration_us: u64, cores: &[u32]) -> Need {
    Need {
        name: name.to_owned(),
        period_ns: period_ms * MS,
        duration_ns: duration_us * US,
        cores: cores.iter().map(|&core| (0, core)).collect(),
        offset_ns: None,
    }
}

fn request(needs: Vec<Need>, chains: Vec<Bound>) -> Request {
    Request {
        modules: vec!["fcu".to_owned()],
        needs,
        chains,
        minor_frame_ns: None,
        major_frame_ns: None,
        gap_ns: 0,
    }
}

fn bound(stations: &[usize], max_age_us: u64) -> Bound {
    Bound { name: format!("chain {stations:?}"), stations: stations.to_vec(), max_age_ns: max_age_us * US }
}

/// A whole schedule file with the answer in it, with a sampling channel for every step of every chain.
fn file(request: &Request, answer: &Answer, cores: &[u32]) -> String {
    let mut text = format!("[module.fcu]\ncores = {cores:?}\n");
    let mut channels = String::new();
    let mut ports = vec![String::new(); request.needs.len()];
    for (place, chain) in request.chains.iter().enumerate() {
        let mut path = Vec::new();
        for (step, pair) in chain.stations.windows(2).enumerate() {
            let (from, to) = (&request.needs[pair[0]].name, &request.needs[pair[1]].name);
            let port = format!("c{place}_{step}");
            writeln!(
                ports[pair[0]],
                "{port}o = {{ direction = \"source\", kind = \"sampling\", message = \"Rates\" }}"
            )
            .unwrap();
            writeln!(ports[pair[1]], "{port}i = {{ direction = \"destination\", kind = \"sampling\", message = \"Rates\", refresh = \"10s\" }}").unwrap();
            writeln!(channels, "[[channel]]\nsource = \"{from}.{port}o\"\ndestinations = [\"{to}.{port}i\"]")
                .unwrap();
            path.push(format!("{from}.{port}o"));
            path.push(format!("{to}.{port}i"));
        }
        writeln!(
            channels,
            "[[chain]]\nname = \"{place}\"\npath = {path:?}\nmax_age = \"{}ns\"",
            chain.max_age_ns
        )
        .unwrap();
    }
    for (need, ports) in request.needs.iter().zip(&ports) {
        let name = &need.name;
        writeln!(text, "[partition.{name}]\nprogram = \"{name}\"\nmodule = \"fcu\"\nmemory = \"1MiB\"")
            .unwrap();
        writeln!(text, "[partition.{name}.port]\n{ports}").unwrap();
    }
    text.push_str(&channels);
    writeln!(
        text,
        "[schedule.s]\nmajor_frame = \"{}ns\"\nminor_frame = \"{}ns\"\nwindow = [",
        answer.major_frame_ns, answer.minor_frame_ns
    )
    .unwrap();
    for window in &answer.windows {
        let need = &request.needs[window.need];
        let minor = window.minor.as_ref().map_or_else(String::new, |list| format!(", minor = {list:?}"));
        writeln!(
            text,
            "{{ partition = \"{}\", offset = \"{}ns\", duration = \"{}ns\", core = {}{minor} }},",
            need.name, window.offset_ns, need.duration_ns, window.core
        )
        .unwrap();
    }
    text + "]\n"
}

#[track_caller]
fn assert_holds(request: &Request, answer: &Answer, cores: &[u32]) {
    let text = file(request, answer, cores);
    let (plan, _) = answer_to("planned.toml", &text).unwrap_or_else(|report| panic!("{report}\n{text}"));
    // Every need has its time.
    for (place, need) in request.needs.iter().enumerate() {
        let id = plan.partition(&need.name).unwrap();
        let windows = plan.schedules[0].windows.iter().filter(|window| window.partition == id);
        let count: usize = windows.map(|window| window.minor.len()).sum();
        assert_eq!(count as u64, answer.major_frame_ns / need.period_ns, "{}", need.name);
        if let Some(wish) = need.offset_ns {
            assert!(answer.windows.iter().any(|window| window.need == place && window.offset_ns == wish));
        }
    }
}

#[test]
fn a_chain_is_laid_in_its_order() {
    let request = request(
        ["servo", "imu", "estimator"].map(|name| need(name, 20, 1_000, &[1])).to_vec(),
        vec![bound(&[1, 2, 0], 3_000)],
    );
    let answer = plan(&request).unwrap();
    assert_holds(&request, &answer, &[1]);
    let order: Vec<usize> = answer.windows.iter().map(|window| window.need).collect();
    assert_eq!(order, [1, 2, 0]);
}

#[test]
fn a_chain_over_two_cores_waits_for_the_writer_to_close() {
    let mut needs = vec![need("a", 20, 2_000, &[1]), need("b", 20, 2_000, &[2])];
    needs.push(need("c", 20, 2_000, &[1]));
    let request = request(needs, vec![bound(&[0, 1, 2], 6_000)]);
    assert_holds(&request, &plan(&request).unwrap(), &[1, 2]);
}

#[test]
fn a_partition_faster_than_the_minor_frame_has_several_windows_in_it() {
    let needs = vec![need("fast", 5, 500, &[1]), need("slow", 20, 3_000, &[1])];
    let request = Request { minor_frame_ns: Some(20 * MS), ..request(needs, Vec::new()) };
    let answer = plan(&request).unwrap();
    assert_eq!(answer.windows.iter().filter(|window| window.need == 0).count(), 4);
    assert_holds(&request, &answer, &[1]);
}

#[test]
fn what_can_not_be_is_said_with_its_reason() {
    let one = |needs: Vec<Need>, chains| plan(&request(needs, chains)).unwrap_err().to_string();
    assert_eq!(
        one(vec![need("a", 20, 1_000, &[1]), need("b", 30, 1_000, &[1])], Vec::new()),
        "the period of `b`, 30ms, neither divides the minor frame of 20ms nor is a multiple of it"
    );
    assert_eq!(
        one(vec![need("a", 20, 15_000, &[1]), need("b", 40, 15_000, &[1])], Vec::new()),
        "core 1 of `fcu` would have to give 45ms in each 40ms, which is 5ms too much"
    );
    assert_eq!(
        one(
            vec![
                need("a", 20, 15_000, &[1, 2]),
                need("b", 20, 15_000, &[1, 2]),
                need("c", 20, 15_000, &[1, 2])
            ],
            Vec::new()
        ),
        "the 2 cores of `fcu` would have to give 45ms in each 20ms, which is 5ms too much"
    );
    assert_eq!(
        one(vec![need("a", 20, 4_000, &[1]), need("b", 20, 4_000, &[1])], vec![bound(&[0, 1], 7_000)]),
        "chain `chain [0, 1]` can not be younger than 8ms, which its windows take one after the other, and 7ms is allowed"
    );
    assert_eq!(
        one(vec![need("a", 20, 1_000, &[1]), need("b", 200, 30_000, &[1])], Vec::new()),
        "the window of `b` takes 30ms, and the minor frame is only 20ms"
    );
    let wish = |name, at| Need { offset_ns: Some(at * MS), ..need(name, 20, 2_000, &[1]) };
    assert_eq!(
        one(vec![wish("a", 4), wish("b", 5)], Vec::new()),
        "`a` and `b` wish for the same time on core 1"
    );
    assert_eq!(
        one(vec![wish("a", 19)], Vec::new()),
        "the window of `a` can not begin at 19ms: it would end after 20ms"
    );
    assert!(matches!(plan(&request(Vec::new(), Vec::new())), Err(Impossible::Nothing)));
}

#[test]
fn windows_beyond_what_a_core_may_have_are_refused_before_any_is_laid_out() {
    let every = |name: &str, period_ns| Need { period_ns, duration_ns: 100, ..need(name, 1, 1, &[1]) };
    let frame = |minor_frame_ns, needs| Request {
        minor_frame_ns: Some(minor_frame_ns),
        ..request(needs, Vec::new())
    };
    // A unit for another: 10^9 windows, which are more than the memory of most machines.
    let wrong = frame(1_000_000 * MS, vec![every("a", US), every("b", US)]);
    assert_eq!(
        plan(&wrong).unwrap_err().to_string(),
        "`a` would have 1000000000 windows in the major frame of 1000s, and 100000 is the most of a core: ask for a longer \
         period, or for a shorter minor frame"
    );
    let several = frame(60 * MS, vec![every("a", US), every("b", US)]);
    assert_eq!(plan(&several), Err(Impossible::TooManyInAll { count: 120_000, major_ns: 60 * MS }));
    let longest = 1 << 62;
    let overflowing =
        frame(longest, vec![every("a", longest), every("b", 3 * longest), every("c", 2 * longest)]);
    assert_eq!(plan(&overflowing), Err(Impossible::MajorTooLong));
}

#[test]
fn as_many_windows_as_a_core_may_have_are_planned() {
    let every = |name: &str, offset| Need {
        period_ns: 20 * US,
        duration_ns: US,
        offset_ns: offset,
        ..need(name, 1, 1, &[1])
    };
    let needs = vec![every("a", Some(3 * US)), every("b", None), every("c", None), every("d", Some(5 * US))];
    let request = Request { minor_frame_ns: Some(500 * MS), ..request(needs, vec![bound(&[0, 1, 2], 40)]) };
    assert_eq!(plan(&request).unwrap().windows.len(), 100_000);
}

#[test]
fn order_and_age_that_can_not_both_hold_are_named() {
    // The wishes put the reader before the writer.
    let wish = |name, at| Need { offset_ns: Some(at * MS), ..need(name, 20, 1_000, &[1]) };
    let request = request(vec![wish("a", 10), wish("b", 2)], vec![bound(&[0, 1], 5_000)]);
    let error = plan(&request).unwrap_err().to_string();
    assert!(error.contains("chain `chain [0, 1]` comes out at 13ms, and 5ms is allowed"), "{error}");
    assert!(error.contains("does not prove"), "{error}");
}

#[test]
fn sixty_four_partitions_on_four_cores_are_planned() {
    // Half of all time, in three rates, with eight chains of four.
    let periods = [20, 20, 40, 80];
    let needs: Vec<Need> = (0..64)
        .map(|n| need(&format!("p{n}"), periods[n % 4], 300 + 200 * (n as u64 % 5), &[1, 2, 3, 4]))
        .collect();
    let chains = (0..8).map(|n| bound(&[8 * n, 8 * n + 1, 8 * n + 4, 8 * n + 5], 15_000)).collect();
    let request = request(needs, chains);
    let answer = plan(&request).unwrap_or_else(|error| panic!("{error}"));
    assert_holds(&request, &answer, &[1, 2, 3, 4]);
    assert_eq!(plan(&request).unwrap(), answer, "the same every time");
}

fn requests() -> impl Strategy<Value = Request> {
    let one = (0_usize..4, 1_u64..30, 0_u32..4, proptest::option::weighted(0.1, 0_u64..10));
    let chain = (proptest::collection::vec(0_usize..24, 2..5), 10_u64..200);
    (proptest::collection::vec(one, 1..24), proptest::collection::vec(chain, 0..4), 0_u64..3).prop_map(
        |(needs, chains, gap)| {
            let needs: Vec<Need> = needs
                .into_iter()
                .enumerate()
                .map(|(n, (rate, length, core, offset))| Need {
                    offset_ns: offset.map(|ms| ms * MS),
                    ..need(
                        &format!("p{n}"),
                        [10, 20, 40, 80][rate],
                        length * 100,
                        if core == 3 {
                            &[1, 2]
                        } else if core == 2 {
                            &[2]
                        } else {
                            &[1]
                        },
                    )
                })
                .collect();
            let count = needs.len();
            let chains = chains.into_iter().filter_map(|(stations, age_ms)| {
                let mut seen = std::collections::BTreeSet::new();
                let stations: Vec<usize> =
                    stations.into_iter().filter(|&station| station < count && seen.insert(station)).collect();
                (stations.len() > 1).then(|| bound(&stations, age_ms * 1_000))
            });
            Request { gap_ns: gap * 50 * US, ..request(needs, chains.collect()) }
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 96, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn every_answer_passes_the_checker(request in requests()) {
        if let Ok(answer) = plan(&request) {
            assert_holds(&request, &answer, &[1, 2]);
        }
    }
}
