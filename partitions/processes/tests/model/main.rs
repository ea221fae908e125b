//! A second implementation of the rules, made to be read and not to be fast: it keeps no lists and no heap, but looks at every process for
//! every question. Random scripts of calls, instants and faults must find no difference between it and the crate.
#![allow(clippy::unwrap_used, clippy::panic)] // a test may be blunt

mod calls;
mod model;
mod objects;
mod plan;

use bateleur_processes::standard::*;
use bateleur_processes::{Dispatch, Partition, Runner, Settings};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use calls::{random_call, real};
use model::Model;
use plan::Plan;

/// Scripts of one run; each makes some ten to a hundred steps.
const SCRIPTS: u64 = 100_000;

#[test]
fn random_scripts_find_no_difference_from_the_simple_model() {
    let mut steps = 0;
    for seed in 0..SCRIPTS {
        steps += script(seed);
    }
    assert!(steps > 20 * SCRIPTS, "only {steps} steps: the scripts end too early");
}

/// Runs one script on both; gives its steps.
fn script(seed: u64) -> u64 {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let plan = Plan::random(&mut random);
    let mut partition = partition(&plan);
    let mut model = Model::new(&plan);
    let mut history = Vec::new();
    for step in 0..random.random_range(10..100_u64) {
        if random.random_range(0..4) == 0 {
            // Full ms, so that several things fall on one instant.
            let now = partition.get_time() + ms(random.random_range(0..8));
            history.push(format!("{now}"));
            partition.advance(now);
            model.advance(now);
        } else {
            let call = random_call(&mut random, &plan, &partition);
            history.push(format!("{:?} {call:?}", partition.dispatch()));
            if !call.is_fault() && !matches!(partition.dispatch(), Dispatch::Run { .. }) {
                continue;
            }
            let (found, expected) = (real(&mut partition, call), model.call(call));
            assert_eq!(found, expected, "seed {seed}: {plan:#?} {}", history.join("\n"));
        }
        compare(&partition, &model, || format!("seed {seed}: {plan:#?} {}", history.join("\n")));
        if matches!(partition.dispatch(), Dispatch::Ended(_)) {
            return step + 1;
        }
    }
    history.len() as u64
}

fn ms(span: i64) -> SystemTime {
    span * 1_000_000
}

/// Creates in the partition what the plan has.
fn partition(plan: &Plan) -> Partition {
    let mut settings = Settings::every(ms(10));
    settings.limits.processes = plan.processes.len();
    settings.limits.object_memory = 1000;
    settings.limits.notices = 4;
    settings.limits.errors = 3;
    let mut partition = Partition::new(settings);
    for (place, process) in plan.processes.iter().enumerate() {
        let attributes = ProcessAttributes {
            name: Name::new(&format!("p{place}")).unwrap(),
            entry_point: 0,
            stack_size: 64 << 10,
            base_priority: process.priority,
            period: process.period,
            time_capacity: process.capacity,
            deadline: Deadline::Soft,
        };
        partition.create_process(&attributes).unwrap();
    }
    let discipline = u32::from(plan.by_priority);
    partition.create_buffer("b", 4, 2, discipline).unwrap();
    partition.create_blackboard("b", 4).unwrap();
    partition.create_semaphore("s", 0, 2, discipline).unwrap();
    partition.create_event("e").unwrap();
    for (place, priority) in plan.mutexes.iter().enumerate() {
        partition.create_mutex(&format!("m{place}"), *priority, discipline).unwrap();
    }
    if plan.handler {
        partition.create_error_handler(64 << 10).unwrap();
    }
    partition
}

/// Everything that can be seen is the same.
fn compare(partition: &Partition, model: &Model, about: impl Fn() -> String) {
    let who = match partition.dispatch() {
        Dispatch::Run { who, life } => Some((who, life)),
        Dispatch::Nobody | Dispatch::Ended(_) => None,
    };
    assert_eq!(who, model.running().map(|who| (who, model.life(who))), "who runs; {}", about());
    assert_eq!(
        matches!(partition.dispatch(), Dispatch::Ended(_)),
        model.ended,
        "whether it runs; {}",
        about()
    );
    if model.ended {
        return;
    }
    assert_eq!(partition.next_timer(), model.next_timer(), "the next timer; {}", about());
    for (place, id) in partition.processes().enumerate() {
        let status = partition.get_process_status(id).unwrap();
        let found = (status.state, status.current_priority, status.deadline_time);
        assert_eq!(found, model.status(place), "status of process {place}; {}", about());
        assert_eq!(partition.get_process_mutex_state(id), Ok(model.mutex_of(place)), "mutex; {}", about());
    }
    assert_eq!(partition.get_partition_status().lock_level, model.lock_level, "lock; {}", about());
    model.compare_objects(partition, &about);
    if let Some((Runner::Process(id), _)) = who {
        let process = &model.processes[id.0 as usize - 1];
        assert_eq!(partition.result(), process.result, "result; {}", about());
        assert_eq!(partition.message(), process.message, "message; {}", about());
    }
}
