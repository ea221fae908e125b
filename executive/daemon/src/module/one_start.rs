//! One start of a module: its channels, the helpers beside it, and the run.

use std::cell::RefCell;
use std::fs::File;
use std::os::fd::OwnedFd;
use std::path::PathBuf;
use std::rc::Rc;
use std::sync::Arc;

use bateleur_contract::Clock;

use super::base::{Base, Lines, port_log, remove_earlier};
use super::channel_holders::ChannelHolders;
use super::course::{Course, Ended};
use super::run_module::{Services, module_start, run_module};
use super::{Options, RunError, machine};
use crate::recording::part_name;
use bateleur_host::error_log::ErrorReader;
use bateleur_host::helper::orders::{Examination, ExaminedPort, Order};
use bateleur_host::machine::Machine;
use bateleur_host::memory_blocks::MemoryBlocks;
use bateleur_host::sealed::SealedChannels;
use bateleur_monitor::cleanup::EndedHelpers;
use bateleur_monitor::rebuild::RebuildHooks;
use bateleur_plan::{ModuleView, PartitionId, Plan};

impl Base {
    /// Makes channels, starts helpers, and runs the module until it ends.
    pub(super) fn run(
        &self,
        plan: &Arc<Plan>,
        view: &ModuleView<'_>,
        options: &Options,
        facts: &Machine,
        programs: Vec<PathBuf>,
        course: &mut Course,
    ) -> Result<Ended, RunError> {
        let order = self.order(view);
        let sealed = SealedChannels::make(view.plan(), view.channels())
            .map_err(machine("cannot make the memory of the sealed channels"))?;
        let sealed = Arc::new(sealed);
        let kept = options.supervision.as_ref().map(|kept| kept.memory_blocks.clone()).unwrap_or_default();
        let (folder, warm) = (&options.order.plan_folder, course.follows_dead());
        let memory_blocks = Arc::new(MemoryBlocks::begin(view, folder, &kept, warm)?);
        let mut shared = order.clone();
        shared.channels.retain(|channel| !sealed.contains(&channel.name));
        let homes: Vec<String> = shared.channels.iter().map(|channel| channel.name.clone()).collect();
        self.instance
            .make_channel_directories(&homes, self.users)
            .map_err(machine("cannot make the channels' directories in /dev/shm"))?;
        let start_observer = self.observer_starter(order.clone(), sealed.clone())?;
        let ended_helpers = EndedHelpers::default();
        let channel_holders = ChannelHolders::begin(self.copy()?, shared.clone(), ended_helpers.clone());
        let channel_holders = channel_holders.map_err(|error| RunError::Machine {
            what: "cannot make the module's channels".into(),
            why: error.0,
        })?;
        if !options.order.record && course.resets() == 0 {
            // What an earlier run recorded in this folder would be taken for this one's.
            let earlier = options.order.output.join(part_name(0));
            remove_earlier(&earlier);
            let _ = std::fs::remove_file(&earlier); // there is none, as a rule
        }
        let port_log = options.port_log().map(|path| port_log(&path, course.resets()));
        let record = |path| self.record(path, &order, &view.plan().messages, sealed.clone());
        let recording = port_log.map(record).transpose()?;
        let play = |play| self.play(plan, &order, play, &sealed, course.reached_ns());
        let player = options.order.play.as_ref().map(play).transpose()?;
        let begin = module_start(&options.order.module, options.order.clock(), course.resets());
        let error_reader = ErrorReader::start(options.order.output.join("partitions"), &begin)
            .map_err(machine("cannot read the partitions' standard error"))?;
        let memories = (error_reader.logs(), sealed.clone(), memory_blocks, course.logbooks.clone());
        let sandboxes = self.sandboxes(plan, view, options, facts, programs, memories)?;
        let (control, inbox) = self.open_control(&options.order.module, course);
        let start_channel_cleaner = self.channel_cleaner_starter(facts.ruled)?;
        let crash_reporter = self.crash_reporter(&options.order.output, facts)?;
        let rebuilds = self.rebuilds(shared, plan.clone(), channel_holders)?;
        // On the virtual clock nobody is cleaned up after at an instant of the wall clock.
        let ended_helpers = (options.order.clock() == Clock::Wall).then_some((ended_helpers, homes));
        let services = Services {
            recording,
            player,
            start_channel_cleaner,
            crash_reporter,
            ended_helpers,
            rebuilds,
            start_observer,
            inbox,
            error_reader,
            run: self.instance.name.clone(),
        };
        let ended = run_module(plan, view, options, facts, sandboxes, services, course);
        drop(control);
        ended
    }

    /// How a partition's channels are examined, held, and rebuilt.
    fn rebuilds(
        &self,
        order: Order,
        plan: Arc<Plan>,
        channel_holders: Rc<RefCell<ChannelHolders>>,
    ) -> Result<RebuildHooks, RunError> {
        let channel_probe = self.copy()?;
        let examine = move |partition| {
            let (answers, answer_end) = std::io::pipe()?;
            let answer_end = OwnedFd::from(answer_end);
            let order = examination(&order, &plan, partition);
            let lines = Lines { output: Some(&answer_end), ..Lines::default() };
            let process =
                channel_probe.helper(&["channel-probe".into(), serde_json::to_string(&order)?], lines)?;
            Ok((process, File::from(OwnedFd::from(answers))))
        };
        let tended = channel_holders.clone();
        Ok(RebuildHooks {
            examine: Box::new(examine),
            rebuild: Box::new(move |channels| channel_holders.borrow_mut().rebuild(channels)),
            tend: Box::new(move || tended.borrow_mut().tend()),
        })
    }
}

/// What a channel probe is told about a partition's ports.
fn examination(order: &Order, plan: &Plan, partition: PartitionId) -> Examination {
    let ports = plan.own_ports(&plan[partition]).filter_map(|id| {
        let source = plan[plan[id].channel?].source;
        let name = plan.port_path(source);
        let channel = order.channels.iter().find(|channel| channel.name == name)?.clone();
        Some(ExaminedPort { channel, writes: source == id })
    });
    Examination { root: order.root.clone(), ports: ports.collect() }
}
