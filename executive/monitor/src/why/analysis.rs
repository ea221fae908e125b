//! Who had a processor in a span of time, by the events of its trace.

use std::collections::{HashMap, VecDeque};

use bateleur_system::trace::{Event, Interrupt, What};

/// Who has a processor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) enum Who {
    /// No thread.
    Idle,
    Thread(i32),
    Interrupt(Interrupt),
}

/// A stretch of time in which one had it, CLOCK_MONOTONIC, ns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Stretch {
    pub(super) from_ns: u64,
    pub(super) to_ns: u64,
    pub(super) who: Who,
    /// Whose the processor is where an interrupt has it; 0: no thread's.
    thread: i32,
}

impl Stretch {
    pub(super) fn length_ns(&self) -> u64 {
        self.to_ns - self.from_ns
    }
}

/// What the trace knows of a span.
#[derive(Debug, Default)]
pub(super) struct Span {
    pub(super) stretches: Vec<Stretch>,
    /// Threads that gave the processor away or were woken: when, who, and whether it sleeps from then on.
    pub(super) left: Vec<(u64, i32, bool)>,
    /// When the thread that is watched was last told to run, up to the span's end.
    pub(super) woken_ns: Option<u64>,
}

/// Interrupts that interrupt each other, most.
const DEEPEST: usize = 16;
/// Events before a span that are looked at, most: who has the processor as it begins is among them. What threads did before is in [`Left`].
const LOOK_BACK: usize = 2_048;
/// Threads that are remembered, most.
const MOST_LEFT: usize = 1_024;

/// When each thread gave the processor away or was woken last, and whether it sleeps since then: a trace has too many events to look for
/// that whenever somebody asks.
#[derive(Debug, Default)]
pub(super) struct Left(HashMap<i32, (u64, bool)>);

impl Left {
    /// These have happened after those that were noted.
    pub(super) fn note<'a>(&mut self, events: impl Iterator<Item = &'a Event>) {
        for event in events {
            let Some((at_ns, thread, sleeps)) = change(event) else { continue };
            if self.0.len() >= MOST_LEFT && !self.0.contains_key(&thread) {
                self.0.clear();
            }
            self.0.insert(thread, (at_ns, sleeps));
        }
    }

    /// Those who did before `until_ns` and have not had it since.
    fn before(&self, until_ns: u64) -> impl Iterator<Item = (u64, i32, bool)> {
        let all = self.0.iter().map(|(thread, (at_ns, sleeps))| (*at_ns, *thread, *sleeps));
        all.filter(move |(at_ns, ..)| *at_ns < until_ns)
    }
}

fn change(event: &Event) -> Option<(u64, i32, bool)> {
    match event.what {
        What::Switch { sleeps, .. } => Some((event.at_ns, event.thread, sleeps)),
        What::Waking(thread) => Some((event.at_ns, thread, false)),
        _ => None,
    }
}

/// `None`: the trace does not reach back to the span's begin. `watched`: the thread that waited, if it is known.
pub(super) fn span(
    events: &VecDeque<Event>,
    left: &Left,
    (from_ns, to_ns): (u64, u64),
    watched: Option<i32>,
) -> Option<Span> {
    let before = events.partition_point(|event| event.at_ns <= from_ns);
    if before == 0 {
        return None;
    }
    let events = events.range(before.saturating_sub(LOOK_BACK)..);
    let mut has = events.clone().next()?.thread;
    let mut interrupts: Vec<Interrupt> = Vec::new();
    let (mut span, mut since_ns) = (Span::default(), from_ns);
    // Somebody waits from here on: a new stretch begins, though nobody else has the processor.
    let mut wakes = false;
    span.left.extend(left.before(events.clone().next()?.at_ns));
    for event in events {
        // A switch before it was left out, or is in what was lost. It came right after the event before,
        // where that is what woke this thread.
        if event.thread != has && event.what != What::Lost {
            has = event.thread;
            interrupts.clear(); // nothing switches within an interrupt
        }
        let until_ns = event.at_ns.min(to_ns);
        if until_ns > since_ns {
            span.add(since_ns, until_ns, has, interrupts.last(), std::mem::take(&mut wakes));
            since_ns = until_ns;
        }
        if event.at_ns >= to_ns {
            break;
        }
        span.left.extend(change(event));
        wakes |= matches!(event.what, What::Waking(_));
        match event.what {
            What::Switch { to, .. } => {
                has = to;
                interrupts.clear();
            }
            What::Begin(interrupt) if interrupts.len() < DEEPEST => interrupts.push(interrupt),
            What::Begin(_) => {}
            What::End(interrupt) => {
                if let Some(place) = interrupts.iter().rposition(|one| *one == interrupt) {
                    interrupts.truncate(place);
                }
            }
            What::Waking(thread) if Some(thread) == watched => span.woken_ns = Some(event.at_ns),
            What::Waking(_) => {}
            What::Lost if event.at_ns > from_ns => return None,
            What::Lost => interrupts.clear(),
        }
    }
    if to_ns > since_ns {
        span.add(since_ns, to_ns, has, interrupts.last(), wakes);
    }
    Some(span)
}

impl Span {
    fn add(&mut self, from_ns: u64, to_ns: u64, thread: i32, interrupt: Option<&Interrupt>, anew: bool) {
        let who = match interrupt {
            Some(interrupt) => Who::Interrupt(*interrupt),
            None if thread == 0 => Who::Idle,
            None => Who::Thread(thread),
        };
        match self.stretches.last_mut() {
            Some(last) if !anew && (last.who, last.thread, last.to_ns) == (who, thread, from_ns) => {
                last.to_ns = to_ns;
            }
            _ => self.stretches.push(Stretch { from_ns, to_ns, who, thread }),
        }
    }

    /// How long each had it from `from_ns` on and until `to_ns`, longest first.
    pub(super) fn shares(&self, from_ns: u64, to_ns: u64) -> Vec<(Who, u64)> {
        let mut shares: Vec<(Who, u64)> = Vec::new();
        for stretch in &self.stretches {
            let length = stretch.to_ns.min(to_ns).saturating_sub(stretch.from_ns.max(from_ns));
            if length == 0 {
                continue;
            }
            match shares.iter_mut().find(|(who, _)| *who == stretch.who) {
                Some((_, sum)) => *sum += length,
                None => shares.push((stretch.who, length)),
            }
        }
        shares.sort_by_key(|(_, length)| std::cmp::Reverse(*length));
        shares
    }
}

/// Who is the reason.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Verdict {
    /// He had it for so long.
    Had(Who, u64),
    /// The timer's interrupt came so late, while nobody had the processor, or whose thread could have been interrupted.
    LateTimer(Who, u64),
    /// Whoever waited had it for so long.
    Itself(u64),
    /// A partition waited for something else than a processor for so long.
    Slept(u64),
}

/// A dispatcher, thread `watched`, came late: it waited for its timer, and then for the processor.
pub(super) fn judge_dispatcher(span: &Span, (from_ns, to_ns): (u64, u64), watched: Option<i32>) -> Verdict {
    let woken_ns = span.woken_ns.unwrap_or(from_ns).clamp(from_ns, to_ns);
    let is_own = |who: &Who| matches!(who, Who::Thread(thread) if Some(*thread) == watched);
    // The timer waits where interrupts are off, and where there is no processor at all.
    if (woken_ns - from_ns) * 2 > to_ns - from_ns {
        let shares = span.shares(from_ns, woken_ns);
        let handling: u64 =
            shares.iter().filter(|(who, _)| matches!(who, Who::Interrupt(_))).map(|(_, length)| length).sum();
        return match shares.first() {
            _ if handling * 2 > woken_ns - from_ns => longest_interrupt(&shares),
            Some((who, _)) if is_own(who) => Verdict::Itself(woken_ns - from_ns),
            Some((who, _)) => Verdict::LateTimer(*who, woken_ns - from_ns),
            None => Verdict::LateTimer(Who::Idle, woken_ns - from_ns),
        };
    }
    let shares = span.shares(woken_ns, to_ns);
    // One interrupt after the other is a storm, though each thread between them may have had more.
    let handling: u64 =
        shares.iter().filter(|(who, _)| matches!(who, Who::Interrupt(_))).map(|(_, length)| length).sum();
    if handling * 2 > to_ns - woken_ns {
        return longest_interrupt(&shares);
    }
    match shares.iter().find(|(who, _)| !matches!(who, Who::Interrupt(_))) {
        Some((who, length)) if is_own(who) => Verdict::Itself(*length),
        // Nobody keeps a thread that is to run from an idle processor but who has the processor itself.
        Some((Who::Idle, length)) => Verdict::LateTimer(Who::Idle, *length),
        Some((who, length)) => Verdict::Had(*who, *length),
        None => longest_interrupt(&shares),
    }
}

fn longest_interrupt(shares: &[(Who, u64)]) -> Verdict {
    let longest = shares.iter().find(|(who, _)| matches!(who, Who::Interrupt(_)));
    longest.map_or(Verdict::LateTimer(Who::Idle, 0), |(who, length)| Verdict::Had(*who, *length))
}

/// A partition had a window and did not close it. `is_its`: whether a thread is one of it. `starved`: it is known that it waited for a
/// processor.
pub(super) fn judge_partition(span: &Span, starved: bool, is_its: &mut dyn FnMut(i32) -> bool) -> Verdict {
    let (mut own_ns, mut slept_ns) = (0, 0);
    let mut others: Vec<(Who, u64)> = Vec::new();
    // Those of its threads that were made to give the processor away. Until one of them had it, it waited for its first one.
    let (mut kept_waiting, mut has_run) = (Vec::new(), false);
    let mut left = span.left.iter().peekable();
    for stretch in &span.stretches {
        let length = stretch.length_ns();
        while let Some((_, thread, sleeps)) = left.next_if(|(at_ns, ..)| *at_ns <= stretch.from_ns) {
            if is_its(*thread) {
                has_run = true;
                kept_waiting.retain(|one| one != thread);
                kept_waiting.extend((!sleeps).then_some(*thread));
            }
        }
        match stretch.who {
            Who::Thread(thread) if is_its(thread) => {
                (own_ns, has_run) = (own_ns + length, true);
                kept_waiting.retain(|one| *one != thread);
            }
            _ if has_run && kept_waiting.is_empty() && !starved && !is_its(stretch.thread) => {
                slept_ns += length;
            }
            Who::Idle if starved => {}
            who => match others.iter_mut().find(|(one, _)| *one == who) {
                Some((_, sum)) => *sum += length,
                None => others.push((who, length)),
            },
        }
    }
    let taken = others.into_iter().max_by_key(|(_, length)| *length);
    match taken {
        Some((who, length)) if length > own_ns && length > slept_ns => Verdict::Had(who, length),
        _ if slept_ns > own_ns => Verdict::Slept(slept_ns),
        _ => Verdict::Itself(own_ns),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DISPATCHER: i32 = 5;
    const TIMER: Interrupt = Interrupt::Own("timer");

    fn switch(at_ns: u64, from: i32, to: i32) -> Event {
        Event { at_ns, thread: from, what: What::Switch { sleeps: false, to } }
    }

    fn sleeps(at_ns: u64, from: i32, to: i32) -> Event {
        Event { at_ns, thread: from, what: What::Switch { sleeps: true, to } }
    }

    /// While this thread has the processor.
    fn during(thread: i32, at_ns: u64, what: What) -> Event {
        Event { at_ns, thread, what }
    }

    fn spanned(events: &[Event], bounds: (u64, u64), watched: Option<i32>) -> Option<Span> {
        let mut left = Left::default();
        left.note(events.iter());
        span(&events.iter().copied().collect(), &left, bounds, watched)
    }

    fn judged(events: &[Event]) -> Verdict {
        let span_of = (1_000, 2_000);
        let found = spanned(events, span_of, Some(DISPATCHER)).unwrap();
        let sum: u64 = found.stretches.iter().map(Stretch::length_ns).sum();
        assert_eq!(sum, 1_000, "every instant is somebody's: {found:?}");
        judge_dispatcher(&found, span_of, Some(DISPATCHER))
    }

    fn thread(thread: i32) -> Who {
        Who::Thread(thread)
    }

    #[test]
    fn a_dispatcher_that_is_woken_in_time_and_has_no_processor_was_kept_from_it_by_who_had_it() {
        let events = [
            switch(500, 0, 7),
            during(7, 1_001, What::Begin(TIMER)),
            during(7, 1_002, What::Waking(DISPATCHER)),
            during(7, 1_003, What::End(TIMER)),
            switch(1_900, 7, DISPATCHER),
        ];
        assert_eq!(judged(&events), Verdict::Had(thread(7), 897));
    }

    #[test]
    fn a_timer_that_comes_late_is_not_held_against_who_could_have_been_interrupted() {
        let late =
            [switch(500, 9, 7), during(7, 1_990, What::Waking(DISPATCHER)), switch(1_995, 7, DISPATCHER)];
        assert_eq!(judged(&late), Verdict::LateTimer(thread(7), 990));
        let idle =
            [switch(500, 9, 0), during(0, 1_990, What::Waking(DISPATCHER)), switch(1_995, 0, DISPATCHER)];
        assert_eq!(judged(&idle), Verdict::LateTimer(Who::Idle, 990));
    }

    #[test]
    fn interrupts_one_after_the_other_are_the_reason_together() {
        let net = Interrupt::Soft(3);
        let mut events = vec![switch(500, 0, 7), during(7, 1_000, What::Waking(DISPATCHER))];
        for begin in (1_001..1_990).step_by(10) {
            events.extend([during(7, begin, What::Begin(net)), during(7, begin + 7, What::End(net))]);
        }
        events.push(switch(1_995, 7, DISPATCHER));
        assert!(matches!(judged(&events), Verdict::Had(Who::Interrupt(one), 690..) if one == net));
    }

    #[test]
    fn who_gives_the_processor_away_in_the_first_event_has_had_it_before() {
        let events = [
            during(7, 900, What::Begin(TIMER)),
            during(7, 901, What::End(TIMER)),
            switch(1_800, 7, DISPATCHER),
        ];
        assert_eq!(judged(&events), Verdict::Had(thread(7), 800));
    }

    /// Kernels leave out how a thread got an idle processor: found with one whose trace has no switch from there.
    #[test]
    fn a_thread_whose_begin_is_not_in_the_trace_has_had_the_processor_since_what_woke_it() {
        let events = [
            switch(500, 7, 0),
            during(0, 990, What::Begin(TIMER)),
            during(0, 1_100, What::End(TIMER)),
            during(7, 1_001 + 400, What::Begin(TIMER)),
            during(7, 1_402, What::Waking(DISPATCHER)),
            during(7, 1_403, What::End(TIMER)),
            switch(1_900, 7, DISPATCHER),
        ];
        let found = spanned(&events, (1_000, 2_000), Some(DISPATCHER)).unwrap();
        assert_eq!(
            found.shares(1_000, 2_000),
            [(thread(7), 301 + 497), (Who::Interrupt(TIMER), 100 + 2), (thread(DISPATCHER), 100),]
        );
        // The last event before the span's end says nothing of what comes after it: the next one does.
        let events = [switch(500, 7, 0), during(0, 990, What::End(TIMER)), switch(2_500, 7, DISPATCHER)];
        assert_eq!(judged(&events), Verdict::Had(thread(7), 1_000));
    }

    #[test]
    fn a_trace_that_begins_later_or_has_a_gap_knows_nothing() {
        let begun = [switch(1_001, 0, 7)];
        assert!(spanned(&begun, (1_000, 2_000), None).is_none());
        let gap = [switch(500, 0, 7), during(0, 1_500, What::Lost), switch(1_600, 7, 8)];
        assert!(spanned(&gap, (1_000, 2_000), None).is_none());
        assert!(spanned(&[], (1_000, 2_000), None).is_none());
    }

    #[test]
    fn a_partition_is_blamed_for_what_it_used_and_others_for_what_they_took_from_it() {
        let judged = |events: &[Event], starved| {
            let found = spanned(events, (1_000, 2_000), None).unwrap();
            judge_partition(&found, starved, &mut |thread| [20, 21].contains(&thread))
        };
        let had_it = [switch(900, 0, 20), switch(1_500, 20, 21)];
        assert_eq!(judged(&had_it, false), Verdict::Itself(1_000));
        let preempted = [switch(900, 0, 20), switch(1_100, 20, 7)];
        assert_eq!(judged(&preempted, false), Verdict::Had(thread(7), 900));
        let never = [switch(900, 0, 7), switch(1_990, 7, 20)];
        assert_eq!(judged(&never, false), Verdict::Had(thread(7), 990));
        // Whoever has the processor while it sleeps takes nothing from it.
        let slept = [switch(900, 0, 20), sleeps(1_100, 20, 7), switch(1_500, 7, 0)];
        assert_eq!(judged(&slept, false), Verdict::Slept(900));
        let one_waits = [switch(900, 0, 20), switch(1_050, 20, 21), sleeps(1_100, 21, 7)];
        assert_eq!(judged(&one_waits, false), Verdict::Had(thread(7), 900));
        assert_eq!(judged(&slept, true), Verdict::Had(thread(7), 400), "it is known that it starved");
        let waited = [switch(800, 0, 20), sleeps(900, 20, 7), switch(1_900, 7, 20)];
        assert_eq!(judged(&waited, false), Verdict::Slept(900));
        let interrupted =
            [switch(900, 0, 20), during(20, 1_100, What::Begin(TIMER)), during(20, 1_800, What::End(TIMER))];
        assert_eq!(judged(&interrupted, false), Verdict::Had(Who::Interrupt(TIMER), 700));
        // The grant has woken it.
        let woken = [
            switch(800, 0, 20),
            sleeps(900, 20, DISPATCHER),
            during(DISPATCHER, 1_001, What::Waking(20)),
            switch(1_002, DISPATCHER, 7),
            switch(1_900, 7, 20),
        ];
        assert_eq!(judged(&woken, false), Verdict::Had(thread(7), 898));
        // Whoever wakes it and goes on keeps it from the processor.
        let kept = [
            switch(800, 0, 20),
            sleeps(900, 20, 7),
            during(7, 1_200, What::Waking(20)),
            switch(1_900, 7, 20),
        ];
        assert_eq!(judged(&kept, false), Verdict::Had(thread(7), 700));
    }

    /// A partition's thread that went to sleep long before, while others have kept the processor busy.
    #[test]
    fn what_a_thread_did_before_the_events_that_are_looked_at_is_remembered() {
        let mut events = vec![switch(1, 0, 20), sleeps(2, 20, 7)];
        events.extend((3..9_000).map(|at_ns| switch(at_ns, 7 + (at_ns % 2) as i32, 8 - (at_ns % 2) as i32)));
        for starts_ns in [8_000, 100] {
            let found = spanned(&events, (starts_ns, starts_ns + 500), None).unwrap();
            assert_eq!(judge_partition(&found, false, &mut |thread| thread == 20), Verdict::Slept(500));
            assert!(found.left.len() <= LOOK_BACK + 503, "{}", found.left.len());
        }
    }

    #[test]
    fn any_events_in_order_account_for_the_whole_span() {
        let mut seed = 7_u64;
        let mut random = |below: u64| {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (seed >> 33) % below
        };
        for _ in 0..5_000 {
            let mut at_ns = 0;
            let events: Vec<Event> = (0..random(60))
                .map(|_| {
                    at_ns += random(90);
                    let thread = random(6) as i32;
                    let interrupt = if random(2) == 0 { TIMER } else { Interrupt::Soft(random(3) as u32) };
                    let what = match random(5) {
                        0 | 1 => What::Switch { sleeps: random(2) == 0, to: thread },
                        2 => What::Begin(interrupt),
                        3 => What::End(interrupt),
                        _ => What::Waking(DISPATCHER),
                    };
                    Event { at_ns, thread: random(6) as i32, what }
                })
                .collect();
            let Some(found) = spanned(&events, (1_000, 2_000), Some(DISPATCHER)) else { continue };
            assert_eq!(found.stretches.iter().map(Stretch::length_ns).sum::<u64>(), 1_000);
            assert!(found.stretches.is_sorted_by_key(|stretch| stretch.from_ns));
            let _ = judge_dispatcher(&found, (1_000, 2_000), Some(DISPATCHER));
        }
    }
}
