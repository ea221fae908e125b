//! Plans of several modules: what each of them runs, what its relay is told, and that the shipped ones differ from the plan
//! of one module only in where partitions run and when.

// A test may be blunt: a panic is how it fails.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod plan_support;

use bateleur_checker::{Facts, check_with_warnings};
use bateleur_contract::{ClockRole, PortKind, RelayTable};
use bateleur_plan::{ModuleId, Plan, Role};
use plan_support::{Table, repository};
use serde_json::Value;

fn text_of(name: &str) -> String {
    std::fs::read_to_string(repository().join(name)).unwrap()
}

fn plan_of(name: &str, text: &str) -> Plan {
    match check_with_warnings(name, text, &Table) {
        Ok((plan, report)) => {
            assert_eq!(report.warnings(), 0, "{report}");
            plan
        }
        Err(report) => panic!("{report}"),
    }
}

fn shipped(name: &str) -> Plan {
    plan_of(name, &text_of(name))
}

fn two() -> Plan {
    shipped("schedules/two-hosts.toml")
}

fn id(plan: &Plan, module: &str) -> ModuleId {
    plan.module(module).unwrap().id()
}

fn table(plan: &Plan, module: &str) -> RelayTable {
    plan.relay_table(id(plan, module)).unwrap().unwrap()
}

/// A plan without what may differ from host to host: tables of modules, networks, links, relays; where a partition runs; the
/// windows.
fn functions(plan: &Plan) -> Value {
    let mut value = serde_json::to_value(plan).unwrap();
    for key in ["modules", "networks", "links"] {
        value.as_object_mut().unwrap().remove(key).unwrap();
    }
    let partitions = value["partitions"].as_array_mut().unwrap();
    partitions.retain(|partition| partition["relay"] == false);
    for partition in partitions {
        let partition = partition.as_object_mut().unwrap();
        partition.remove("module").unwrap();
        partition.remove("processes").unwrap(); // their periods follow from windows, their numbers from modules
    }
    value["ports"].as_array_mut().unwrap().retain(|port| port["payload"]["message"]["name"] != "LinkStatus");
    for schedule in value["schedules"].as_array_mut().unwrap() {
        schedule.as_object_mut().unwrap().remove("windows").unwrap();
    }
    value
}

#[test]
fn the_shipped_schedules_of_several_hosts_differ_in_modules_windows_and_one_channel_only() {
    let schedule = text_of("schedule.toml");
    // The Controller's verdict on the pitot would cross the networks: one port of the Estimator is on one host only.
    let (before, after) = schedule.split_once("[partition.estimator.port]").unwrap();
    let port = after.lines().find(|line| line.starts_with("command ")).unwrap();
    let schedule = format!("{before}[partition.estimator.port]{}", after.replacen(port, "", 1));
    let one = functions(&plan_of("schedule.toml", &schedule.replace(", \"estimator.command\"", "")));
    for name in ["two-hosts", "controls-apart", "three-hosts"] {
        let several = shipped(&format!("schedules/{name}.toml"));
        assert!(several.modules.len() > 1);
        assert_eq!(functions(&several), one, "{name}");
    }
}

#[test]
fn the_windows_of_partitions_are_as_long_on_several_hosts_as_on_one() {
    let lengths = |plan: &Plan| {
        let schedule = &plan[plan.initial_schedule()];
        let own = schedule.windows.iter().filter(|window| !plan[window.partition].relay);
        let mut all: Vec<(String, u64)> =
            own.map(|window| (plan[window.partition].name.clone(), window.duration_ns)).collect();
        all.sort();
        all
    };
    let one = lengths(&shipped("schedule.toml"));
    for name in ["two-hosts", "controls-apart", "three-hosts"] {
        assert_eq!(lengths(&shipped(&format!("schedules/{name}.toml"))), one, "{name}");
    }
}

#[test]
fn nothing_of_a_local_plan_crosses_and_no_place_has_changed() {
    let plan = two();
    for module in ["fcu", "nav"] {
        let local = plan.local(id(&plan, module));
        let view = local.module(module).unwrap();
        let crossing: Vec<String> =
            view.crossing_channels().map(|channel| local.port_path(local[channel].source)).collect();
        assert_eq!(crossing, [""; 0], "{module}");
        assert_eq!(local.partitions.len(), plan.partitions.len());
        for (before, after) in plan.ports.iter().zip(&local.ports) {
            assert_eq!((&before.name, before.partition), (&after.name, after.partition));
        }
        assert_eq!(local.schedules, plan.schedules);
    }
}

#[test]
fn a_crossing_channel_leads_to_the_relay_here_and_from_the_relay_there() {
    let plan = two();
    let channel = plan[plan.port("estimator.state").unwrap()].channel.unwrap();
    let (nav, fcu) = (plan.local(id(&plan, "nav")), plan.local(id(&plan, "fcu")));
    let ends = |local: &Plan| {
        let destinations = local[channel].destinations.iter().map(|&port| local.port_path(port));
        (local.port_path(local[channel].source), destinations.collect::<Vec<_>>())
    };
    assert_eq!(ends(&nav), ("estimator.state".into(), vec!["relay_nav.estimator.state.nav".into()]));
    let here = ["controller.state".to_owned(), "command.state".to_owned()];
    assert_eq!(ends(&fcu), ("relay_fcu.estimator.state".into(), here.to_vec()));
    let (out, inside) = (nav[channel].destinations[0], fcu[channel].source);
    assert!(matches!(nav[out].role, Role::SamplingDestination { .. }));
    assert_eq!(fcu[inside].role, Role::SamplingSource);
    assert_eq!(nav[out].payload, fcu[inside].payload);
    assert_eq!(fcu.port("relay_fcu.estimator.state"), Some(inside));
}

#[test]
fn a_channel_with_readers_on_both_sides_keeps_those_that_are_here() {
    let plan = two();
    let channel = plan[plan.port("rate_generator.rate").unwrap()].channel.unwrap();
    let fcu = plan.local(id(&plan, "fcu"));
    let readers: Vec<String> = fcu[channel].destinations.iter().map(|&port| fcu.port_path(port)).collect();
    assert_eq!(readers.len(), 8, "seven here, and the relay: {readers:?}");
    assert!(readers.contains(&"relay_fcu.rate_generator.rate.nav".to_owned()));
    assert!(!readers.contains(&"estimator.rate".to_owned()));
}

#[test]
fn a_queue_is_as_deep_at_the_relay_as_at_its_reader() {
    let plan = two();
    let nav = plan.local(id(&plan, "nav"));
    let out = nav.port("relay_nav.estimator.telemetry.nav").unwrap();
    assert_eq!(nav[out].role, Role::QueuingDestination { depth: 8 });
}

#[test]
fn both_ends_of_a_link_are_told_the_same() {
    for name in ["two-hosts", "controls-apart", "three-hosts"] {
        let plan = shipped(&format!("schedules/{name}.toml"));
        for link in &plan.links {
            let names = link.ends.map(|module| plan[module].name.as_str());
            let tables = names.map(|module| table(&plan, module));
            assert_eq!(tables[0].digest, tables[1].digest);
            assert_eq!(tables[0].digest.len(), 64);
            assert_eq!(tables[0].sections, tables[1].sections);
            let of = |end: usize| tables[end].links.iter().find(|one| one.name == link.name).unwrap();
            let (one, other) = (of(0), of(1));
            assert_eq!((one.id, one.gap_ns, one.max_datagram), (other.id, other.gap_ns, other.max_datagram));
            assert_eq!((one.peer.as_str(), other.peer.as_str()), (names[1], names[0]));
            assert!(one.initiator && !other.initiator && one.authenticated && other.authenticated);
            for (here, there) in one.paths.iter().zip(&other.paths) {
                assert_eq!((here.local, here.remote), (there.remote, there.local));
            }
            assert_eq!(one.channels.len(), other.channels.len());
            assert!(!one.channels.is_empty(), "{name}: {}", link.name);
            for (here, there) in one.channels.iter().zip(&other.channels) {
                assert_eq!((here.id, &here.name, here.kind), (there.id, &there.name, there.kind));
                assert_eq!(
                    (here.max_bytes, here.depth, here.period_ns),
                    (there.max_bytes, there.depth, there.period_ns)
                );
                assert_ne!(here.outgoing, there.outgoing);
            }
        }
    }
}

#[test]
fn every_channel_of_a_table_has_its_port_in_the_local_plan() {
    for name in ["two-hosts", "controls-apart", "three-hosts"] {
        let plan = shipped(&format!("schedules/{name}.toml"));
        for module in &plan.modules {
            let local = plan.local(id(&plan, &module.name));
            for channel in table(&plan, &module.name).links.iter().flat_map(|link| &link.channels) {
                let path = format!("relay_{}.{}", module.name, channel.port);
                let port = local.port(&path).unwrap_or_else(|| panic!("{name}: no port {path}"));
                assert!(local[port].channel.is_some());
                let queuing = channel.kind == PortKind::Queuing;
                assert_eq!(queuing, local[port].kind().to_string() == "queuing");
            }
        }
    }
}

#[test]
fn who_follows_is_told_so() {
    let plan = shipped("schedules/three-hosts.toml");
    let roles = |module: &str| -> Vec<(String, ClockRole)> {
        table(&plan, module).links.iter().map(|link| (link.name.clone(), link.clock)).collect()
    };
    assert_eq!(roles("fcu"), [("nav".into(), ClockRole::Leader), ("ctl".into(), ClockRole::Leader)]);
    assert_eq!(roles("nav"), [("nav".into(), ClockRole::Follower), ("state".into(), ClockRole::None)]);
}

#[test]
fn the_digest_is_of_what_both_hosts_must_agree_on() {
    let text = text_of("schedules/two-hosts.toml");
    let digest = |text: &str| plan_of("edited.toml", text).digest().unwrap();
    let same = digest(&text);
    for (old, new) in [
        ("# sensors go out", "# out with the sensors"),
        ("keys/nav.key", "/etc/bateleur/nav.key"),
        ("rate    = \"100Mbit/s\"", "rate = \"100 Mbit/s\""),
    ] {
        assert!(text.contains(old), "{old}");
        assert_eq!(digest(&text.replace(old, new)), same, "{new}");
    }
    for (old, new) in [
        ("offset = \"6.6ms\"", "offset = \"6.61ms\""),
        ("pressure_aiding = true", "pressure_aiding = false"),
        ("10.78.0.2:15300", "10.78.0.9:15300"),
        ("gap     = \"2ms\"", "gap     = \"1ms\""),
        ("laps = 2", "laps = 3"),
    ] {
        assert!(text.contains(old), "{old}");
        assert_ne!(digest(&text.replace(old, new)), same, "{new}");
    }
    // Where they differ is said by name.
    let moved = plan_of("edited.toml", &text.replace("laps = 2", "laps = 3"));
    let (here, there) = (table(&two(), "fcu").sections, table(&moved, "fcu").sections);
    let differ: Vec<&String> = here.keys().filter(|key| here[*key] != there[*key]).collect();
    assert_eq!(differ, ["partition controller"]);
}

#[test]
fn the_table_holds_no_key() {
    let text = serde_json::to_string(&table(&two(), "fcu")).unwrap();
    assert!(!text.contains("key"), "{text}");
}

#[test]
fn channels_keep_their_numbers_when_a_partition_moves() {
    let numbers = |plan: &Plan| -> Vec<(u16, String)> {
        let link = table(plan, "fcu");
        link.links.iter().flat_map(|link| &link.channels).map(|one| (one.id, one.name.clone())).collect()
    };
    let (two, three) = (numbers(&two()), numbers(&shipped("schedules/three-hosts.toml")));
    for (id, name) in &two {
        assert!(three.iter().all(|(other, named)| (named == name) == (other == id)), "{name}");
    }
}

#[test]
fn a_module_without_anything_that_crosses_has_no_relay() {
    let plan = shipped("schedule.toml");
    assert!(plan.relay_of(id(&plan, "fcu")).is_none());
    assert!(plan.relay_table(id(&plan, "fcu")).unwrap().is_none());
    assert_eq!(plan.local(id(&plan, "fcu")), plan);
}

#[test]
fn the_chain_over_two_hosts_is_bounded_and_counts_its_relays() {
    let plan = two();
    let facts = Facts::of(&plan);
    let [chain] = facts.schedules[0].chains.as_slice() else { panic!("{facts:?}") };
    let way: Vec<&str> = chain.way.iter().map(|step| step.partition.as_str()).collect();
    let expected = [
        "hil_interface",
        "imu",
        "relay_fcu",
        "relay_nav",
        "estimator",
        "relay_nav",
        "relay_fcu",
        "controller",
        "servo",
    ];
    assert_eq!(way, expected);
    assert_eq!((chain.age_ns, chain.max_age_ns), (12_000_000, 25_000_000));
    // Without a common phase the bound has a pause of each relay in it, and is above what is allowed.
    let text = text_of("schedules/two-hosts.toml").replace("max_age = \"25ms\"", "max_age = \"80ms\"");
    let apart = text.replace("follows   = \"fcu\"", "").replace("follows_within = \"200us\"", "");
    let (plan, _) = check_with_warnings("apart.toml", &apart, &Table).unwrap();
    let age_ns = Facts::of(&plan).schedules[0].chains[0].age_ns;
    assert!((40_000_000..60_000_000).contains(&age_ns), "{age_ns}");
}

#[test]
fn a_link_says_what_it_costs() {
    let plan = two();
    let facts = Facts::of(&plan);
    let [fcu, nav] = facts.schedules[0].links.as_slice() else { panic!("{facts:?}") };
    assert_eq!((fcu.module.as_str(), fcu.peer.as_str(), nav.module.as_str()), ("fcu", "nav", "nav"));
    assert_eq!((fcu.relay_ns, fcu.relay_windows), (5_000_000, 10));
    assert_eq!(fcu.channels, 8, "the beat, seven of sensors, less none; and orders from the ground");
    assert!(fcu.window_datagrams <= fcu.window_datagrams_most);
    assert!(fcu.window_bytes <= fcu.window_datagrams * fcu.datagram_room_bytes);
    // (1452 + 86) bytes every 2 ms.
    assert!(fcu.networks.iter().all(|network| network.reserved_bits_per_s == 6_152_000));
    assert_eq!(fcu.aligned_within_ns, Some(200_000));
}

#[test]
fn modules_on_the_disciplined_clock_have_a_common_phase_for_rules_and_facts_alike() {
    let text = text_of("schedules/two-hosts.toml").replace("max_age = \"25ms\"", "max_age = \"80ms\"");
    let free = text.replace("follows   = \"fcu\"", "").replace("follows_within = \"200us\"", "");
    let disciplined = free.replace("[module.fcu]", "[module.fcu]\nclock = \"realtime\"");
    let disciplined = disciplined.replace("[module.nav]", "[module.nav]\nclock = \"realtime\"");
    let answer = |text: &str| {
        let (plan, report) = check_with_warnings("clocks.toml", text, &Table).unwrap();
        let noted = report.violations().iter().any(|one| one.rule == "L06-chain-crosses-modules");
        (noted, Facts::of(&plan).schedules[0].links[0].aligned_within_ns)
    };
    assert_eq!(answer(&free), (true, None));
    assert_eq!(answer(&disciplined), (false, Some(2_000_000)), "1 ms each where nothing is said");
}
