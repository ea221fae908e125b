//! Partitions written with the traits and macros of `a653rs`, as for that project's Linux hypervisor. The partition's name in the plan says
//! which one this is. Each reports `done` when all of it was as it should be, and panics where something is not.
#![allow(static_mut_refs, unsafe_code, missing_docs, dead_code, unused_variables, elided_lifetimes_in_paths)] // what the macros write
#![allow(clippy::unwrap_used, clippy::panic)]

use a653rs::prelude::{ApexErrorP4Ext, PartitionExt};
use a653rs_linux::partition::{ApexLinuxPartition, ApexLogger};
use log::LevelFilter;

fn main() {
    ApexLogger::install_panic_hook();
    ApexLogger::install_logger(LevelFilter::Info).unwrap();
    match ApexLinuxPartition::get_partition_name().as_str() {
        "hello" => hello::Partition.run(),
        "ping" => ping::Partition.run(),
        "pong" => pong::Partition.run(),
        "asker" => asker::Partition.run(),
        "answerer" => answerer::Partition.run(),
        "tank" => tank::Partition.run(),
        "valve" => valve::Partition.run(),
        "gauge" => gauge::Partition.run(),
        "dice" => dice::Partition.run(),
        "objects" => objects::Objects.run(),
        "processes" => processes::Processes.run(),
        "errors" => errors::Errors.run(),
        "blocks" => blocks::Blocks.run(),
        name => panic!("no partition {name}"),
    }
}

fn done() {
    ApexLinuxPartition::report_application_message(b"done").unwrap();
}

/// One process with the partition's period, and one that never waits, with a higher priority.
#[a653rs::partition(a653rs_linux::partition::ApexLinuxPartition)]
mod hello {
    use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

    static TURNS: AtomicU32 = AtomicU32::new(0);

    #[start(cold)]
    fn cold_start(mut ctx: start::Context) {
        ctx.create_greets().unwrap().start().unwrap();
        ctx.create_counts().unwrap().start().unwrap();
    }

    #[start(warm)]
    fn warm_start(ctx: start::Context) {
        cold_start(ctx);
    }

    #[aperiodic(time_capacity = "Infinite", stack_size = "8KB", base_priority = 2, deadline = "Soft")]
    fn counts(ctx: counts::Context) {
        loop {
            ctx.get_time();
            TURNS.fetch_add(1, Relaxed);
        }
    }

    #[periodic(
        period = "0ms",
        time_capacity = "Infinite",
        stack_size = "8KB",
        base_priority = 1,
        deadline = "Hard"
    )]
    fn greets(ctx: greets::Context) {
        for round in 0..50 {
            log::info!("hello in round {round}");
            let before = ctx.get_time().unwrap_duration().as_millis();
            ctx.periodic_wait().unwrap();
            assert_eq!(ctx.get_time().unwrap_duration().as_millis(), before + 20);
        }
        assert!(TURNS.load(Relaxed) > 1000, "the other one has what is left");
        assert_eq!(ctx.proc_self.status().attributes.stack_size, greets::STACK_SIZE);
        super::done();
        log::warn!("a warning is seen from outside");
    }
}

/// Sends its time, and is sent it back.
#[a653rs::partition(a653rs_linux::partition::ApexLinuxPartition)]
mod ping {
    #[sampling_out(name = "out", msg_size = "8B")]
    struct Request;

    #[sampling_in(name = "in", msg_size = "8B", refresh_period = "100ms")]
    struct Response;

    #[start(cold)]
    fn cold_start(mut ctx: start::Context) {
        ctx.create_request().unwrap();
        ctx.create_response().unwrap();
        ctx.create_asks().unwrap().start().unwrap();
    }

    #[start(warm)]
    fn warm_start(ctx: start::Context) {
        cold_start(ctx);
    }

    #[periodic(
        period = "20ms",
        time_capacity = "Infinite",
        stack_size = "16KB",
        base_priority = 1,
        deadline = "Soft"
    )]
    fn asks(ctx: asks::Context) {
        let mut answers = 0;
        while answers < 20 {
            let mut buffer = [0_u8; 8];
            let now = ctx.get_time().unwrap_duration().as_millis() as u64;
            if let Ok((validity, bytes)) = ctx.response.unwrap().receive(&mut buffer) {
                assert_eq!(validity, Validity::Valid);
                let sent = u64::from_le_bytes(bytes.try_into().unwrap());
                assert_eq!(now - sent, 20, "answered in the same frame");
                answers += 1;
            }
            ctx.request.unwrap().send(&now.to_le_bytes()).unwrap();
            assert_eq!(ctx.request.unwrap().send(&[0; 9]), Err(Error::InvalidConfig));
            ctx.periodic_wait().unwrap();
        }
        super::done();
    }
}

/// Sends back what it is sent.
#[a653rs::partition(a653rs_linux::partition::ApexLinuxPartition)]
mod pong {
    #[sampling_in(name = "in", msg_size = "8B", refresh_period = "100ms")]
    struct Request;

    #[sampling_out(name = "out", msg_size = "8B")]
    struct Response;

    #[start(cold)]
    fn cold_start(mut ctx: start::Context) {
        ctx.create_request().unwrap();
        ctx.create_response().unwrap();
        ctx.create_answers().unwrap().start().unwrap();
    }

    #[start(warm)]
    fn warm_start(ctx: start::Context) {
        cold_start(ctx);
    }

    #[periodic(
        period = "20ms",
        time_capacity = "Infinite",
        stack_size = "16KB",
        base_priority = 1,
        deadline = "Soft"
    )]
    fn answers(ctx: answers::Context) {
        for round in 0.. {
            let mut buffer = [0_u8; 8];
            if let Ok((_, bytes)) = ctx.request.unwrap().receive(&mut buffer) {
                ctx.response.unwrap().send(bytes).unwrap();
            }
            if round == 20 {
                super::done();
            }
            ctx.periodic_wait().unwrap();
        }
    }
}

/// Sends questions of different lengths into a queue, and waits for each answer.
#[a653rs::partition(a653rs_linux::partition::ApexLinuxPartition)]
mod asker {
    #[queuing_out(name = "questions", msg_size = "16B", msg_count = "4", discipline = "Fifo")]
    struct Questions;

    #[queuing_in(name = "answers", msg_size = "32B", msg_count = "4", discipline = "Fifo")]
    struct Answers;

    #[start(cold)]
    fn cold_start(mut ctx: start::Context) {
        ctx.create_questions().unwrap();
        ctx.create_answers().unwrap();
        ctx.create_asks().unwrap().start().unwrap();
    }

    #[start(warm)]
    fn warm_start(ctx: start::Context) {
        cold_start(ctx);
    }

    #[aperiodic(time_capacity = "Infinite", stack_size = "16KB", base_priority = 1, deadline = "Soft")]
    fn asks(ctx: asks::Context) {
        let (questions, answers) = (ctx.questions.unwrap(), ctx.answers.unwrap());
        let mut buffer = [0_u8; 32];
        for length in 1..=16_usize {
            questions.send(&vec![7; length], SystemTime::Infinite).unwrap();
            let (answer, overflow) = answers.receive(&mut buffer, SystemTime::Infinite).unwrap();
            assert!(answer == vec![7; 2 * length] && !overflow);
        }
        let short = SystemTime::Normal(core::time::Duration::from_millis(50));
        assert_eq!(answers.receive(&mut buffer, short.clone()).unwrap_err(), Error::TimedOut);
        assert_eq!(questions.send(&[0; 17], short), Err(Error::InvalidConfig));
        super::done();
    }
}

/// Answers each question with twice as many bytes.
#[a653rs::partition(a653rs_linux::partition::ApexLinuxPartition)]
mod answerer {
    #[queuing_in(name = "questions", msg_size = "16B", msg_count = "4", discipline = "Fifo")]
    struct Questions;

    #[queuing_out(name = "answers", msg_size = "32B", msg_count = "4", discipline = "Fifo")]
    struct Answers;

    #[start(cold)]
    fn cold_start(mut ctx: start::Context) {
        ctx.create_questions().unwrap();
        ctx.create_answers().unwrap();
        ctx.create_answers_them().unwrap().start().unwrap();
    }

    #[start(warm)]
    fn warm_start(ctx: start::Context) {
        cold_start(ctx);
    }

    #[periodic(
        period = "0ms",
        time_capacity = "Infinite",
        stack_size = "16KB",
        base_priority = 1,
        deadline = "Soft"
    )]
    fn answers_them(ctx: answers_them::Context) {
        for round in 0.. {
            let mut buffer = [0_u8; 16];
            let zero = SystemTime::Normal(core::time::Duration::ZERO);
            match ctx.questions.unwrap().receive(&mut buffer, zero.clone()) {
                Ok((question, _)) => ctx.answers.unwrap().send(&question.repeat(2), zero).unwrap(),
                Err(error) => assert_eq!(error, Error::NotAvailable),
            }
            if round == 40 {
                super::done();
            }
            ctx.periodic_wait().unwrap();
        }
    }
}

/// A control loop of three: what flows into the tank is what the valve says.
#[a653rs::partition(a653rs_linux::partition::ApexLinuxPartition)]
mod tank {
    #[sampling_out(name = "level", msg_size = "8B")]
    struct Level;

    #[sampling_in(name = "opening", msg_size = "8B", refresh_period = "60ms")]
    struct Opening;

    #[start(cold)]
    fn cold_start(mut ctx: start::Context) {
        ctx.create_level().unwrap();
        ctx.create_opening().unwrap();
        ctx.create_flows().unwrap().start().unwrap();
    }

    #[start(warm)]
    fn warm_start(ctx: start::Context) {
        cold_start(ctx);
    }

    #[periodic(
        period = "20ms",
        time_capacity = "10ms",
        stack_size = "16KB",
        base_priority = 9,
        deadline = "Hard"
    )]
    fn flows(ctx: flows::Context) {
        let mut level = 0.0_f64;
        for round in 0.. {
            let mut buffer = [0_u8; 8];
            if let Ok((Validity::Valid, bytes)) = ctx.opening.unwrap().receive(&mut buffer) {
                level += f64::from_le_bytes(bytes.try_into().unwrap()) - 0.1 * level;
            }
            ctx.level.unwrap().send(&level.to_le_bytes()).unwrap();
            if round == 90 {
                assert!((level - 5.0).abs() < 0.5, "{level}");
                super::done();
            }
            ctx.periodic_wait().unwrap();
        }
    }
}

/// Opens further as long as the gauge says that there is too little.
#[a653rs::partition(a653rs_linux::partition::ApexLinuxPartition)]
mod valve {
    #[sampling_in(name = "wanting", msg_size = "8B", refresh_period = "60ms")]
    struct Wanting;

    #[sampling_out(name = "opening", msg_size = "8B")]
    struct Opening;

    #[start(cold)]
    fn cold_start(mut ctx: start::Context) {
        ctx.create_wanting().unwrap();
        ctx.create_opening().unwrap();
        ctx.create_turns().unwrap().start().unwrap();
    }

    #[start(warm)]
    fn warm_start(ctx: start::Context) {
        cold_start(ctx);
    }

    #[periodic(
        period = "20ms",
        time_capacity = "Infinite",
        stack_size = "16KB",
        base_priority = 9,
        deadline = "Hard"
    )]
    fn turns(ctx: turns::Context) {
        let mut opening = 0.0_f64;
        for round in 0.. {
            let mut buffer = [0_u8; 8];
            if let Ok((Validity::Valid, bytes)) = ctx.wanting.unwrap().receive(&mut buffer) {
                opening += 0.01 * f64::from_le_bytes(bytes.try_into().unwrap());
            }
            ctx.opening.unwrap().send(&opening.to_le_bytes()).unwrap();
            if round == 90 {
                super::done();
            }
            ctx.periodic_wait().unwrap();
        }
    }
}

/// Says how much is wanting in the tank. A second process watches the first without a period.
#[a653rs::partition(a653rs_linux::partition::ApexLinuxPartition)]
mod gauge {
    use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

    static ROUNDS: AtomicU32 = AtomicU32::new(0);

    #[sampling_in(name = "level", msg_size = "8B", refresh_period = "60ms")]
    struct Level;

    #[sampling_out(name = "wanting", msg_size = "8B")]
    struct Wanting;

    #[start(cold)]
    fn cold_start(mut ctx: start::Context) {
        ctx.create_level().unwrap();
        ctx.create_wanting().unwrap();
        ctx.create_measures().unwrap().start().unwrap();
        ctx.create_watches().unwrap().start().unwrap();
    }

    #[start(warm)]
    fn warm_start(ctx: start::Context) {
        cold_start(ctx);
    }

    #[periodic(
        period = "20ms",
        time_capacity = "Infinite",
        stack_size = "16KB",
        base_priority = 9,
        deadline = "Hard"
    )]
    fn measures(ctx: measures::Context) {
        loop {
            let mut buffer = [0_u8; 8];
            if let Ok((Validity::Valid, bytes)) = ctx.level.unwrap().receive(&mut buffer) {
                let wanting = 5.0 - f64::from_le_bytes(bytes.try_into().unwrap());
                ctx.wanting.unwrap().send(&wanting.to_le_bytes()).unwrap();
            }
            ROUNDS.fetch_add(1, Relaxed);
            ctx.periodic_wait().unwrap();
        }
    }

    #[aperiodic(time_capacity = "Infinite", stack_size = "16KB", base_priority = 9, deadline = "Soft")]
    fn watches(ctx: watches::Context) {
        assert_eq!(Hypervisor::periodic_wait(), Err(Error::InvalidMode));
        while ROUNDS.load(Relaxed) < 80 {
            ctx.get_time();
        }
        super::done();
    }
}

/// Reads the machine's device of random numbers.
#[a653rs::partition(a653rs_linux::partition::ApexLinuxPartition)]
mod dice {
    use std::io::Read;

    #[start(cold)]
    fn cold_start(mut ctx: start::Context) {
        ctx.create_throws().unwrap().start().unwrap();
    }

    #[start(warm)]
    fn warm_start(ctx: start::Context) {
        cold_start(ctx);
    }

    #[periodic(
        period = "20ms",
        time_capacity = "Infinite",
        stack_size = "32KB",
        base_priority = 1,
        deadline = "Soft"
    )]
    fn throws(ctx: throws::Context) {
        let mut seen = [0_u32; 6];
        for _ in 0..50 {
            let mut bytes = [0_u8; 16];
            std::fs::File::open("/dev/urandom").unwrap().read_exact(&mut bytes).unwrap();
            bytes.iter().for_each(|byte| seen[usize::from(byte % 6)] += 1);
            ctx.periodic_wait().unwrap();
        }
        assert!(seen.iter().all(|count| *count > 50), "{seen:?}");
        super::done();
    }
}

/// All objects of Part 1, without macros.
mod objects {
    use std::str::FromStr;
    use std::time::Duration;

    use a653rs::prelude::*;
    use a653rs_linux::partition::ApexLinuxPartition as Apex;

    pub(crate) struct Objects;

    pub(crate) fn process(
        name: &str,
        entry_point: SystemAddress,
        base_priority: Priority,
    ) -> ProcessAttribute {
        ProcessAttribute {
            period: SystemTime::Infinite,
            time_capacity: SystemTime::Infinite,
            entry_point,
            stack_size: 32 * 1024,
            base_priority,
            deadline: Deadline::Soft,
            name: self::name(name),
        }
    }

    pub(crate) fn name(name: &str) -> Name {
        Name::from_str(name).unwrap()
    }

    impl Partition<Apex> for Objects {
        fn cold_start(&self, ctx: &mut StartContext<Apex>) {
            ctx.create_buffer(name("buffer"), 8, 2, QueuingDiscipline::Fifo).unwrap();
            ctx.create_blackboard(name("board"), 8).unwrap();
            ctx.create_semaphore(name("semaphore"), 0, 4, QueuingDiscipline::Priority).unwrap();
            ctx.create_event(name("event")).unwrap();
            ctx.create_mutex(name("mutex"), 50, QueuingDiscipline::Fifo).unwrap();
            assert_eq!(ctx.create_event(name("event")).unwrap_err(), Error::NoAction);
            for (called, entry, priority) in
                [("urgent", urgent as SystemAddress, 20), ("patient", patient, 10)]
            {
                ctx.create_process(process(called, entry, priority)).unwrap().start().unwrap();
            }
        }

        fn warm_start(&self, ctx: &mut StartContext<Apex>) {
            self.cold_start(ctx);
        }
    }

    extern "C" fn urgent() {
        let buffer = Buffer::<Apex>::from_name(name("buffer")).unwrap();
        let mut bytes = [0_u8; 8];
        assert_eq!(buffer.receive(&mut bytes, SystemTime::Infinite).unwrap(), [1, 2, 3]);
        let board = Blackboard::<Apex>::from_name(name("board")).unwrap();
        assert_eq!(board.read(SystemTime::Infinite, &mut bytes).unwrap(), [9, 9]);
        Semaphore::<Apex>::from_name(name("semaphore")).unwrap().wait(SystemTime::Infinite).unwrap();
        let event = Event::<Apex>::from_name(name("event")).unwrap();
        event.wait(SystemTime::Infinite).unwrap();
        let mutex = Mutex::<Apex>::from_name(name("mutex")).unwrap();
        mutex.acquire(SystemTime::Infinite).unwrap();
        assert_eq!(mutex.status().mutex_owner, Process::<Apex>::get_self().unwrap().id());
        mutex.release().unwrap();
        let short = SystemTime::Normal(Duration::from_millis(30));
        assert_eq!(
            Semaphore::<Apex>::from_name(name("semaphore")).unwrap().wait(short),
            Err(Error::TimedOut)
        );
        super::done();
    }

    extern "C" fn patient() {
        Buffer::<Apex>::from_name(name("buffer"))
            .unwrap()
            .send(&mut [1, 2, 3], SystemTime::Infinite)
            .unwrap();
        Blackboard::<Apex>::from_name(name("board")).unwrap().display(&[9, 9]).unwrap();
        Semaphore::<Apex>::from_name(name("semaphore")).unwrap().signal().unwrap();
        let mutex = Mutex::<Apex>::from_name(name("mutex")).unwrap();
        mutex.acquire(SystemTime::Infinite).unwrap();
        assert_eq!(Process::<Apex>::get_self().unwrap().status().current_priority, 50);
        Event::<Apex>::from_name(name("event")).unwrap().set();
        mutex.release().unwrap();
    }
}

/// What processes do to each other, without macros.
mod processes {
    use std::sync::atomic::{AtomicU32, Ordering::Relaxed};
    use std::time::Duration;

    use a653rs::prelude::*;
    use a653rs_linux::partition::ApexLinuxPartition as Apex;

    use super::objects::{name, process};

    pub(crate) struct Processes;

    static LIVES: AtomicU32 = AtomicU32::new(0);

    impl Partition<Apex> for Processes {
        fn cold_start(&self, ctx: &mut StartContext<Apex>) {
            ctx.create_process(process("sleeps", sleeps, 20)).unwrap().start().unwrap();
            ctx.create_process(process("acts", acts, 10)).unwrap().start().unwrap();
            ctx.create_process(process("late", late, 5))
                .unwrap()
                .delayed_start(SystemTime::Normal(Duration::from_millis(100)))
                .unwrap();
        }

        fn warm_start(&self, ctx: &mut StartContext<Apex>) {
            self.cold_start(ctx);
        }
    }

    extern "C" fn sleeps() {
        LIVES.fetch_add(1, Relaxed);
        Process::<Apex>::suspend_self(SystemTime::Infinite).unwrap();
        Process::<Apex>::suspend_self(SystemTime::Infinite).unwrap();
    }

    extern "C" fn late() {
        assert!(Apex::get_time().unwrap_duration() >= Duration::from_millis(100));
        super::done();
    }

    extern "C" fn acts() {
        let sleeper = Apex::get_process(name("sleeps")).unwrap();
        sleeper.resume().unwrap();
        for _ in 0..3 {
            sleeper.stop().unwrap();
            assert_eq!(sleeper.stop(), Err(Error::NoAction));
            sleeper.start().unwrap();
        }
        assert_eq!(LIVES.load(Relaxed), 4);
        assert_eq!(Process::<Apex>::lock_preemption().unwrap(), 1);
        sleeper.stop().unwrap();
        sleeper.start().unwrap();
        assert_eq!(LIVES.load(Relaxed), 4, "nobody else runs now");
        assert_eq!(Process::<Apex>::unlock_preemption().unwrap(), 0);
        assert_eq!(LIVES.load(Relaxed), 5);
        Apex::timed_wait(Duration::from_millis(40)).unwrap();
        Process::<Apex>::stop_self();
    }
}

/// An error handler.
mod errors {
    use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

    use a653rs::prelude::*;
    use a653rs_linux::partition::ApexLinuxPartition as Apex;

    use super::objects::process;

    pub(crate) struct Errors;

    static TOLD: AtomicU32 = AtomicU32::new(0);

    impl Partition<Apex> for Errors {
        fn cold_start(&self, ctx: &mut StartContext<Apex>) {
            ctx.set_error_handler(handles, 32 * 1024).unwrap();
            ctx.create_process(process("raises", raises, 20)).unwrap().start().unwrap();
        }

        fn warm_start(&self, ctx: &mut StartContext<Apex>) {
            self.cold_start(ctx);
        }
    }

    extern "C" fn handles() {
        while let Ok(error) = Apex::error_status() {
            assert_eq!((error.error_code, error.length), (ErrorCode::ApplicationError, 5));
            assert_eq!(&error.message[..5], b"words");
            TOLD.fetch_add(1, Relaxed);
        }
        Process::<Apex>::stop_self();
    }

    extern "C" fn raises() {
        for told in 1..=10 {
            Apex::raise_application_error(b"words").unwrap();
            assert_eq!(TOLD.load(Relaxed), told, "it is told at once");
        }
        super::done();
    }
}

/// A memory block with content, and the module's schedules.
mod blocks {
    use a653rs::prelude::*;
    use a653rs_linux::partition::ApexLinuxPartition as Apex;

    use super::objects::{name, process};

    pub(crate) struct Blocks;

    impl Partition<Apex> for Blocks {
        fn cold_start(&self, ctx: &mut StartContext<Apex>) {
            assert_eq!(Apex::get_memory_block(name("another")).unwrap_err(), Error::InvalidConfig);
            let mut block = MemoryBlock::<Apex>::from_name(name("map")).unwrap();
            assert_eq!(block.mode(), MemoryBlockMode::ReadWrite);
            // SAFETY: no other partition has it.
            let bytes = unsafe { block.write() }.unwrap();
            assert_eq!((bytes.len(), &bytes[..4]), (4096, &b"map\0"[..]));
            bytes[4095] = 7;
            ctx.create_process(process("looks", looks as SystemAddress, 10)).unwrap().start().unwrap();
        }

        fn warm_start(&self, ctx: &mut StartContext<Apex>) {
            self.cold_start(ctx);
        }
    }

    extern "C" fn looks() {
        let block = MemoryBlock::<Apex>::from_name(name("map")).unwrap();
        // SAFETY: no other partition has it.
        assert_eq!(unsafe { block.read() }[4095], 7);
        let only = <Apex as ApexScheduleP2Ext>::get_module_schedule_id(name("only").into()).unwrap();
        let status = <Apex as ApexScheduleP2Ext>::get_module_schedule_status().unwrap();
        assert_eq!((status.current_schedule, status.next_schedule), (only, only));
        assert_eq!(<Apex as ApexScheduleP2Ext>::set_module_schedule(only), Err(Error::NoAction));
        assert_eq!(<Apex as ApexScheduleP2Ext>::set_module_schedule(0), Err(Error::InvalidParam));
        super::done();
    }
}
