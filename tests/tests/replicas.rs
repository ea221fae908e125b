//! Partitions that run three times: what one of them writes wrongly reaches nobody, and it is named and started again.
//!
//! One lie through a flight that nobody's restart has changed leaves it as it is without, to the bit. After a restart replicas may differ in
//! the last digits, and what left the voter is compared with what was written by those that did not lie.

use std::collections::BTreeMap;

use bateleur_messages::ActuatorCommand;
use bateleur_recording::read;
use bateleur_tests::{Ended, Fault, among_others, bateleur, is_long, repository, small_mission};

const KINDS: [&str; 6] = ["stuck", "bias", "swap", "corrupt", "delay", "drop"];
/// Between two lies, module time, s: no replica comes to the end of its five restarts in ten seconds.
const APART_S: f64 = 2.0;
const FRAME_NS: u64 = 20_000_000;

fn schedule() -> String {
    std::fs::read_to_string(repository().join("schedules/replicas.toml")).unwrap()
}

fn fly(schedule: &str, options: &[String]) -> Ended {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("replicas.toml");
    std::fs::write(&path, schedule).unwrap();
    let fixed = ["fly", "--fast", "--format", "json", "--seed", "3", "--schedule", path.to_str().unwrap()];
    let fixed = fixed.map(str::to_owned);
    bateleur(&[&fixed[..], options].concat()).end()
}

fn digest(ended: &Ended) -> String {
    ended.summary()["digest"].as_str().unwrap().to_owned()
}

/// Once around a small triangle.
fn fly_shortly(schedule: &str, options: &[&str]) -> Ended {
    let mission = small_mission();
    let mission = ["--mission", mission.to_str().unwrap()];
    let options = mission.iter().chain(options).map(|&option| option.to_owned());
    fly(schedule, &options.collect::<Vec<_>>()).expect_code(0)
}

/// Numbers that repeat with their seed.
struct Random(u64);

impl Random {
    fn below(&mut self, bound: u64) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % bound
    }
}

/// A replica that lies in its commands.
struct Lie {
    from_ns: u64,
    until_ns: u64,
    replica: usize,
}

/// Lies of one replica at a time through a whole flight, as options, and how many of each kind there are.
fn lies(seed: u64) -> (Vec<String>, Vec<Lie>, BTreeMap<&'static str, usize>) {
    let mut random = Random(seed);
    let (mut options, mut all, mut told) = (Vec::new(), Vec::new(), BTreeMap::new());
    let mut at_s = 1.0;
    while at_s < 195.0 {
        let kind = KINDS[random.below(KINDS.len() as u64) as usize];
        let port = ["command", "command", "status"][random.below(3) as usize];
        let most = [8, 60][random.below(2) as usize];
        let messages = 1 + random.below(most);
        let delay = if kind == "delay" { format!("/{}ms", 30 + random.below(400)) } else { String::new() };
        let replica = 1 + random.below(3) as usize;
        let instant_s = at_s + random.below(300) as f64 / 1000.0;
        options.extend([
            "--inject".to_owned(),
            format!("controller_{replica}.{port}:{kind}={messages}{delay}@{instant_s:.3}"),
        ]);
        let from_ns = (instant_s * 1e9) as u64;
        all.push(Lie { from_ns, until_ns: (at_s * 1e9) as u64 + 2_000_000_000, replica });
        *told.entry(kind).or_default() += 1;
        at_s += APART_S;
    }
    (options, all, told)
}

/// The numbers of a command that the servos follow.
fn surfaces(command: &ActuatorCommand) -> [f64; 4] {
    [command.throttle, command.aileron_rad, command.elevator_rad, command.rudder_rad]
}

/// Every command that left the voter, but for the tolerance lies between what two replicas wrote that did not lie just then. How many were
/// looked at, and how many of the replicas' own were further away.
fn expect_no_wrong_word(ended: &Ended, lies: &[Lie], about: &str) -> (usize, usize) {
    let log = read(ended.folder().join("ports.mcap"), |message| message == "ActuatorCommand").unwrap();
    let track = |partition: &str| {
        let track = log.track(&format!("/{partition}/command"), "ActuatorCommand");
        track.unwrap_or_else(|| panic!("nothing of {partition}")).typed::<ActuatorCommand>()
    };
    let of_frame = |commands: Vec<(u64, ActuatorCommand)>| -> BTreeMap<u64, ActuatorCommand> {
        commands.into_iter().map(|(time_ns, command)| (time_ns / FRAME_NS, command)).collect()
    };
    let replicas = [1, 2, 3].map(|number| of_frame(track(&format!("controller_{number}"))));
    let (mut looked_at, mut wrong) = (0, 0);
    let mut largest = [0.0_f64; 4];
    for (frame, decided) in of_frame(track("controller")) {
        let liar =
            lies.iter().find(|lie| (lie.from_ns..lie.until_ns).contains(&(frame * FRAME_NS + FRAME_NS)));
        let of = |honest: bool| {
            let is_honest = move |number: usize| liar.is_none_or(|lie| lie.replica != number + 1);
            let chosen = (0..3).filter(move |&number| is_honest(number) == honest);
            chosen.filter_map(|number| replicas[number].get(&frame)).map(surfaces).collect::<Vec<_>>()
        };
        let (honest, others) = (of(true), of(false));
        assert!(!honest.is_empty(), "{about}: nobody wrote in frame {frame}");
        for (place, value) in surfaces(&decided).into_iter().enumerate() {
            largest[place] = largest[place].max(value.abs());
            let reach = 0.05 * largest[place];
            let is_near = |one: &[f64; 4]| (one[place] - value).abs() <= reach;
            assert!(honest.iter().any(is_near), "{about}: {value} in frame {frame} and not {honest:?}");
            wrong += others.iter().filter(|other| !is_near(other)).count();
        }
        looked_at += 1;
    }
    (looked_at, wrong)
}

#[test]
fn no_wrong_word_of_one_controller_of_three_leaves_the_voter() {
    let _turn = among_others();
    let text = schedule();
    let (mut told, mut seed) = (BTreeMap::new(), 0);
    let (mut looked_at, mut wrong, mut restarts, mut needless) = (0, 0, 0, 0);
    let enough = if is_long() { 1000 } else { 5 };
    while KINDS.iter().any(|kind| told.get(kind).copied().unwrap_or(0) < enough) {
        seed += 1;
        let (options, lies, kinds) = lies(seed);
        let ended = fly(&text, &options).expect_code(0);
        let (of_flight, wrong_of_flight) = expect_no_wrong_word(&ended, &lies, &format!("seed {seed}"));
        (looked_at, wrong) = (looked_at + of_flight, wrong + wrong_of_flight);
        let faults = ended.faults();
        let outvoted = faults.iter().filter(|fault| fault.error == "outvoted");
        // Messages that differ are forgiven where they are few.
        assert!(outvoted.clone().count() > 10, "seed {seed}: {faults:?}");
        assert!(outvoted.clone().all(|fault| fault.action == "warm_restart"), "seed {seed}: {faults:?}");
        let is_named = |fault: &&Fault| {
            let just_then = |lie: &&Lie| (lie.from_ns..lie.until_ns).contains(&fault.time_ns);
            let liar = lies.iter().find(just_then).expect("a lie");
            fault.partition == format!("controller_{}", liar.replica)
        };
        restarts += outvoted.clone().count();
        needless += outvoted.filter(|fault| !is_named(fault)).count();
        kinds.into_iter().for_each(|(kind, count)| *told.entry(kind).or_default() += count);
    }
    eprintln!("{seed} flights, {told:?}: {looked_at} commands, {wrong} wrong numbers were outvoted");
    assert!(wrong > 20 * seed as usize, "{wrong}");
    // Forty restarts in a flight leave replicas a little apart.
    eprintln!("{restarts} restarts, {needless} of replicas that did not lie");
    assert!(needless * 20 <= restarts, "{needless} of {restarts}");
}

#[test]
fn replica_that_lies_is_named_with_the_field_and_comes_back_with_what_the_others_retain() {
    let _turn = among_others();
    let clean = digest(&fly_shortly(&schedule(), &[]));
    let kinds = ["bias=9999", "delay=9999/200ms", "drop=9999", "stuck=9999", "swap=9999", "corrupt=9999"];
    for kind in &kinds[..if is_long() { 6 } else { 3 }] {
        let lie = format!("controller_2.command:{kind}@40");
        let ended = fly_shortly(&schedule(), &["--inject", &lie]);
        assert_eq!(digest(&ended), clean, "{kind}");
        let outvoted: Vec<_> = ended.faults().into_iter().filter(|fault| fault.error == "outvoted").collect();
        // Once: if its successor knew nothing of the flight, it would be outvoted, too.
        let [fault] = outvoted.as_slice() else { panic!("{kind}: {outvoted:#?}") };
        assert_eq!((fault.partition.as_str(), fault.action.as_str()), ("controller_2", "warm_restart"));
        assert!(fault.detail.starts_with("command"), "{}", fault.detail);
        assert!((40_000_000_000..40_600_000_000).contains(&fault.time_ns), "{fault:?}");
    }
}

#[test]
fn deaths_of_replicas_change_nothing_and_the_flight_outlives_its_voter() {
    let _turn = among_others();
    let clean = digest(&fly_shortly(&schedule(), &[]));
    let kills = ["controller_1@31.013", "controller_2@40.006", "controller_3@50.0085"];
    for kill in &kills[..if is_long() { 3 } else { 1 }] {
        assert_eq!(digest(&fly_shortly(&schedule(), &["--kill", kill])), clean, "{kill}");
    }
    // A cold start is none where another replica knows better.
    let cold = schedule().replace("killed            = \"warm", "killed            = \"cold");
    assert_eq!(digest(&fly_shortly(&cold, &["--kill", "controller_2@40"])), clean);
    let ended = fly_shortly(&schedule(), &["--kill", "controller@30", "--kill", "controller@50.0099"]);
    let faults = ended.faults();
    assert!(faults.iter().all(|fault| fault.partition == "controller"), "{faults:?}");
}

#[test]
fn replica_that_starts_again_flies_with_the_others_to_the_landing_and_is_not_outvoted() {
    let _turn = among_others();
    let mut random = Random(98);
    for seed in 0..if is_long() { 24 } else { 3 } {
        let at_ms = 30_000 + random.below(90_000);
        let kill = format!("controller_{}@{}.{:03}", 1 + seed % 3, at_ms / 1000, at_ms % 1000);
        let wind = format!("{}", random.below(8));
        let air = ["--land", "--turbulence", "light", "--wind", &wind, "--kill", &kill];
        let ended = fly_shortly(&schedule(), &air);
        let restarts: Vec<_> =
            ended.faults().into_iter().filter(|fault| fault.action == "warm_restart").collect();
        assert!(restarts.len() == 1 && restarts[0].error == "killed", "{air:?}: {restarts:#?}");
    }
}

#[test]
fn setting_of_the_partition_is_set_in_each_replica() {
    let _turn = among_others();
    let ended = fly_shortly(&schedule(), &["--set", "controller.path=fly_through"]);
    assert!(ended.faults().is_empty(), "{:?}", ended.faults());
    assert_ne!(digest(&ended), digest(&fly_shortly(&schedule(), &[])));
}

#[test]
fn what_a_replica_writes_into_a_queue_and_what_the_last_one_left_writes_reaches_the_ground() {
    let _turn = among_others();
    for kind in &["corrupt=9999", "drop=9999", "swap=9999", "stuck=9999"][..if is_long() { 4 } else { 2 }] {
        let lie = format!("controller_1.telemetry:{kind}@20");
        let ended = fly_shortly(&schedule(), &["--inject", &lie]);
        assert!(ended.faults().iter().all(|fault| fault.error == "order"), "{kind}: {:?}", ended.faults());
    }
    fly_shortly(&schedule(), &["--stop", "controller_1@30", "--stop", "controller_2@35"]);
}

#[test]
fn voter_that_starts_again_knows_how_far_replicas_may_be_apart() {
    let _turn = among_others();
    let kills = ["controller_1@25", "controller@35", "controller@45", "controller@55"];
    let kills: Vec<&str> = kills.iter().flat_map(|kill| ["--kill", kill]).collect();
    let ended = fly_shortly(&schedule(), &kills);
    assert!(ended.faults().iter().all(|fault| fault.error == "killed"), "{:?}", ended.faults());
}

#[test]
fn replica_that_an_operator_holds_is_not_outvoted() {
    let _turn = among_others();
    let ended = fly_shortly(&schedule(), &["--freeze", "controller_1@30"]);
    assert!(ended.faults().iter().all(|fault| fault.error != "outvoted"), "{:?}", ended.faults());
}

#[test]
fn flight_takes_the_laps_from_the_plan_of_the_replicas() {
    let _turn = among_others();
    let ended = fly(&schedule().replace("laps = 2", "laps = 1"), &[]).expect_code(0);
    assert!(ended.stderr.contains("5 of 5 way-points"), "{}", ended.stderr);
    let replay = bateleur(&["replay", ended.folder().to_str().unwrap()]).end().expect_code(2);
    replay.expect_words(&["`controller` has replicas: a plain loop has one of each function"]);
    fly(&schedule(), &["--engine=one-process".to_owned()])
        .expect_code(2)
        .expect_words(&["partition controller has replicas: fly it with --engine partitions"]);
}

/// The plan above with a replica on each of three computers.
fn on_three_hosts() -> String {
    let (one, three) = (schedule(), std::fs::read_to_string(repository().join("schedules/three-hosts.toml")));
    let three = three.unwrap();
    let between = |text: &str, from: &str, to: &str| {
        let begin = text.find(from).unwrap();
        text[begin..begin + text[begin..].find(to).unwrap()].to_owned()
    };
    let hosts = between(&three, "[network.a]", "[link.state]").replace("\"2ms\"", "\"1ms\"");
    let windows = [
        ("rate_generator", "0ms", "500us"),
        ("hil_interface", "500us", "2.5ms"),
        ("gps", "3.2ms", "500us"),
        ("imu", "3.8ms", "500us"),
        ("estimator", "4.4ms", "2ms"),
        ("relay_fcu", "6.5ms", "500us"),
        ("relay_nav", "8.2ms", "500us"),
        ("relay_ctl", "8.2ms", "500us"),
        ("controller_1", "8.8ms", "1ms"),
        ("controller_2", "8.8ms", "1ms"),
        ("controller_3", "8.8ms", "1ms"),
        ("relay_nav", "9.9ms", "500us"),
        ("relay_ctl", "9.9ms", "500us"),
        ("relay_fcu", "11.6ms", "500us"),
        ("controller", "12.2ms", "500us"),
        ("servo", "12.8ms", "600us"),
        ("onboard_computer", "15.4ms", "500us"),
        ("command", "16ms", "2ms"),
    ];
    let window = |(partition, offset, duration)| {
        format!("{{ partition = \"{partition}\", offset = \"{offset}\", duration = \"{duration}\" }},\n")
    };
    let windows: String = windows.into_iter().map(window).collect();
    one.replace(&between(&one, "[module.fcu]", "[schedule.flight]"), &hosts)
        .replace(&between(&one, "window = [", "[[chain]]"), &format!("window = [\n{windows}]\n"))
        .replace("replicas   = 3", "replicas   = [\"fcu\", \"nav\", \"ctl\"]")
        .replace("max_age = \"25ms\"", "max_age = \"40ms\"")
}

#[test]
fn replicas_on_three_hosts_outvote_one_on_any_of_them() {
    let _turn = among_others();
    let text = on_three_hosts();
    let flown = |more: &[&str]| fly_shortly(&text, &[&["--hosts"], more].concat());
    let clean = digest(&flown(&[]));
    let killed = flown(&["--kill", "controller_2@40"]);
    assert_eq!(digest(&killed), clean);
    let errors = |ended: &Ended, module| -> Vec<String> {
        ended.faults_on(module).into_iter().map(|fault| fault.error).collect()
    };
    assert_eq!(errors(&killed, "nav"), ["killed"]);
    let here = flown(&["--inject", "controller_1.command:swap=100000@40"]);
    assert_eq!(digest(&here), clean);
    let outvoted = here.faults().into_iter().filter(|fault| fault.error == "outvoted");
    assert!(outvoted.map(|fault| fault.partition).eq(["controller_1".to_owned()]));
    // Of one elsewhere the voter's host says it. Its own host restarts it once: late verdicts are about its predecessor.
    let kinds = ["bias=100000", "stuck=100000", "swap=100000", "corrupt=100000"];
    for kind in &kinds[..if is_long() { 4 } else { 1 }] {
        let there = flown(&["--inject", &format!("controller_3.command:{kind}@40")]);
        assert_eq!(digest(&there), clean, "{kind}");
        let named =
            there.faults().into_iter().find(|fault| fault.detail.contains("controller_3 is outvoted"));
        assert!(named.is_some_and(|fault| fault.partition == "controller"), "{kind}: {:?}", there.faults());
        let faults = there.faults_on("ctl");
        let outvoted: Vec<_> = faults.iter().filter(|fault| fault.error == "outvoted").collect();
        let [fault] = outvoted.as_slice() else { panic!("{kind}: {faults:#?}") };
        assert_eq!((fault.partition.as_str(), fault.action.as_str()), ("controller_3", "warm_restart"));
        assert!(fault.detail.starts_with("command") && fault.recovered_ns.is_some(), "{fault:?}");
    }
    // What does not arrive, or late, may be the network's fault: it is named, and nobody is restarted.
    for (fault, module) in [
        (&["--inject", "controller_3.command:delay=100000/200ms@40"][..], "ctl"),
        (&["--inject", "controller_3.command:drop=100000@40"], "ctl"),
        (&["--cut", "a@40-42", "--cut", "b@40-42"], "nav"),
    ]
    .into_iter()
    .take(if is_long() { 3 } else { 1 })
    {
        let ended = flown(fault);
        assert!(
            !errors(&ended, module).contains(&"outvoted".into()),
            "{fault:?}: {:?}",
            ended.faults_on(module)
        );
        assert!(
            ended.faults().iter().any(|fault| fault.error == "outvoted"),
            "{fault:?}: {:?}",
            ended.faults()
        );
    }
    // It has missed two seconds, and nobody gives it another one's memory: it comes to what flies, or does not use up its restarts.
    let thawed = flown(&["--freeze", "controller_3@40", "--thaw", "controller_3@42"]);
    assert_eq!(digest(&thawed), clean);
    let actions: Vec<String> = thawed.faults_on("ctl").into_iter().map(|fault| fault.action).collect();
    assert!(actions.iter().all(|action| action == "warm_restart"), "{actions:?}");
}
