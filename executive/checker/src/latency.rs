//! How old a value is at the end of a path through windows.
//!
//! The rule of sampling: a partition may write at any instant of its window, so what it writes is counted on only
//! by windows that open when that window has closed, or later. From each window of the last partition the path is
//! followed back by that rule; the oldest value over a whole major frame is the bound. Where windows on two cores
//! overlap, the reader may in fact see a newer value, never an older one.
//!
//! Between two modules the value waits for a window of the relay, travels, and is read by a window of the other relay that
//! opens when it has arrived. Where one module follows the other, their frames have one phase, but for the error that is
//! allowed; where not, every phase is possible, and the worst one counts: the value left with the window of the relay
//! before the one whose datagram comes just too late.
//!
//! All of this holds while every window is granted, on time, and used. It must never take the present into account, nor more
//! than about as many steps as there are windows on the path: whoever checks a file waits for it.

use std::cell::OnceCell;

/// One partition's windows in a major frame: start and end in nanoseconds, in any order, none overlapping another.
pub(super) type Windows = Vec<(u64, u64)>;

/// From one module to another.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Hop {
    /// The most that a datagram takes, ns.
    pub(super) latency_ns: u64,
    /// How far apart the major frames of both may begin, ns; `None`: anyhow.
    pub(super) aligned_within_ns: Option<u64>,
    /// How much later than planned the frames where it ends may begin against those where the path does, ns: nothing, where
    /// the path has come back to its module.
    pub(super) beside_first_ns: u64,
}

/// A partition on a path: its windows, and how the value comes to it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Station {
    /// Its windows.
    pub(super) windows: Windows,
    /// From the partition before it: none, by a channel of the module.
    pub(super) hop: Option<Hop>,
}

impl Station {
    /// One that is reached within its module.
    #[cfg(test)]
    fn here(windows: Windows) -> Self {
        Self { windows, hop: None }
    }
}

/// One window on a path, in nanoseconds from the start of the major frame in which the path ends: negative where it
/// lies in an earlier one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
pub struct Visit {
    /// When the window opens.
    pub start_ns: i64,
    /// When it is over.
    pub end_ns: i64,
}

/// The window of the value that a window opening at `instant` reads: the latest that has closed.
fn latest_closed(windows: &Windows, instant: i64, major: i64) -> Option<Visit> {
    let within = instant.rem_euclid(major);
    let frame = instant - within;
    // Sorted by end: see `sorted`.
    let after = windows.partition_point(|&(_, end)| i64::try_from(end).is_ok_and(|end| end <= within));
    let (at, frame) =
        if after > 0 { (windows.get(after - 1)?, frame) } else { (windows.last()?, frame - major) };
    let (start, end) = (i64::try_from(at.0).ok()?, i64::try_from(at.1).ok()?);
    Some(Visit { start_ns: frame + start, end_ns: frame + end })
}

fn sorted(windows: &Windows) -> Windows {
    let mut windows = windows.clone();
    windows.sort_by_key(|&(start, end)| (end, start));
    windows
}

/// Every way through the windows of the `stations`, one for each window of the last of them, in the order of the path.
/// None where a station has no window.
pub(super) fn ways(stations: &[Station], major_ns: u64) -> Vec<Vec<Visit>> {
    let Some((last, before)) = stations.split_last() else { return Vec::new() };
    let Ok(major) = i64::try_from(major_ns) else { return Vec::new() };
    if major == 0 {
        return Vec::new();
    }
    let road = Road::of(before, major);
    let way = |&(start, end): &(u64, u64)| {
        let visit = Visit { start_ns: i64::try_from(start).ok()?, end_ns: i64::try_from(end).ok()? };
        let mut visits = road.back(before.len(), visit, last.hop)?;
        visits.push(visit);
        Some(visits)
    };
    last.windows.iter().filter_map(way).collect()
}

/// The stations before the last one of a path, with what has been found about them.
struct Road {
    /// Their windows sorted: see [`latest_closed`].
    stations: Vec<Station>,
    major: i64,
    /// For each of them: the oldest that a module without a common phase has of it. Who asks only shifts the answer, and without
    /// being kept it would be sought anew for every window of everybody behind it.
    oldest: Vec<OnceCell<Option<Oldest>>>,
}

/// The worst way to a station whose next datagram is waited for.
#[derive(Clone, Debug)]
struct Oldest {
    /// In the station's own time.
    visits: Vec<Visit>,
    /// When the window of the station ends whose datagram replaces it.
    replaced_ns: i64,
}

impl Road {
    fn of(stations: &[Station], major: i64) -> Self {
        let sort = |station: &Station| Station { windows: sorted(&station.windows), hop: station.hop };
        let oldest = stations.iter().map(|_| OnceCell::new()).collect();
        Self { stations: stations.iter().map(sort).collect(), major, oldest }
    }

    /// The worst way through the first `count` stations to the window `to`, which `hop` leads to.
    fn back(&self, count: usize, to: Visit, hop: Option<Hop>) -> Option<Vec<Visit>> {
        let Some(place) = count.checked_sub(1) else { return Some(Vec::new()) };
        let last = self.stations.get(place)?;
        let hop_ns =
            |hop: Hop| i64::try_from(hop.latency_ns.saturating_add(hop.aligned_within_ns.unwrap_or(0))).ok();
        let until = match hop {
            Some(hop) if hop.aligned_within_ns.is_none() => {
                return self.in_any_phase(place, to, hop_ns(hop)?);
            }
            Some(hop) => to.start_ns.checked_sub(hop_ns(hop)?)?,
            None => to.start_ns,
        };
        let visit = latest_closed(&last.windows, until, self.major)?;
        let mut visits = self.back(place, visit, last.hop)?;
        visits.push(visit);
        Some(visits)
    }

    /// The worst way to `to` from the station at `place`, whose module's frames have another phase.
    fn in_any_phase(&self, place: usize, to: Visit, hop_ns: i64) -> Option<Vec<Visit>> {
        let oldest = self.oldest.get(place)?.get_or_init(|| self.oldest(place)).as_ref()?;
        // In the other module's time: the next one's datagram comes as `to` has just opened.
        let shift = to.start_ns.checked_sub(hop_ns)?.checked_sub(oldest.replaced_ns)?;
        oldest.visits.iter().map(|visit| visit.shifted(shift)).collect()
    }

    /// Whichever window of the station it is, its datagram is the newest until the one of the next window has arrived.
    fn oldest(&self, place: usize) -> Option<Oldest> {
        let Station { windows, hop } = self.stations.get(place)?;
        let mut worst: Option<(i64, Oldest)> = None;
        for window in 0..windows.len() {
            let visit = visit_of(windows, window)?;
            let replaced_ns = match visit_of(windows, window + 1) {
                Some(next) => next.end_ns,
                None => visit_of(windows, 0)?.end_ns.checked_add(self.major)?,
            };
            let mut visits = self.back(place, visit, *hop)?;
            visits.push(visit);
            let age = replaced_ns.checked_sub(visits.first()?.start_ns)?;
            if worst.as_ref().is_none_or(|(oldest, _)| age > *oldest) {
                worst = Some((age, Oldest { visits, replaced_ns }));
            }
        }
        worst.map(|(_, oldest)| oldest)
    }
}

fn visit_of(windows: &Windows, place: usize) -> Option<Visit> {
    let &(start, end) = windows.get(place)?;
    Some(Visit { start_ns: i64::try_from(start).ok()?, end_ns: i64::try_from(end).ok()? })
}

impl Visit {
    fn shifted(self, by_ns: i64) -> Option<Self> {
        Some(Self { start_ns: self.start_ns.checked_add(by_ns)?, end_ns: self.end_ns.checked_add(by_ns)? })
    }
}

/// From the opening of the first window to the end of the last, on a way through `stations`: a frame that may begin later than
/// the one it is aligned with ends its windows later too.
pub(super) fn age_ns(stations: &[Station], way: &[Visit]) -> u64 {
    let (Some(first), Some(last)) = (way.first(), way.last()) else { return 0 };
    last.end_ns.abs_diff(first.start_ns).saturating_add(phase_error_ns(stations))
}

/// How much later than planned the last of the stations may be against the first, because their modules' frames are aligned within an
/// error only, ns.
pub(super) fn phase_error_ns(stations: &[Station]) -> u64 {
    stations.iter().rev().find_map(|station| station.hop).map_or(0, |hop| hop.beside_first_ns)
}

/// The way with the oldest value at its end; none where a station has no window.
pub(super) fn worst(stations: &[Station], major_ns: u64) -> Option<Vec<Visit>> {
    // The first of equals, so that the answer is the same every time.
    ways(stations, major_ns).into_iter().rev().max_by_key(|way| age_ns(stations, way))
}

/// The partitions that a path visits, from the owner of each of its ports and whether that port is a source: a step from
/// a source to a destination is a channel, any other stays in the window.
pub(super) fn stations<P: Copy>(path: impl IntoIterator<Item = (P, bool)>) -> Vec<P> {
    let mut list = Vec::new();
    let mut from_source = false;
    for (owner, source) in path {
        if list.is_empty() || (from_source && !source) {
            list.push(owner);
        }
        from_source = source;
    }
    list
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    fn every(frame_ms: u64, frames: u64, start_ms: u64, end_ms: u64) -> Windows {
        (0..frames).map(|n| ((n * frame_ms + start_ms) * MS, (n * frame_ms + end_ms) * MS)).collect()
    }

    fn path(windows: &[Windows]) -> Vec<Station> {
        windows.iter().cloned().map(Station::here).collect()
    }

    fn worst_ms(stations: &[Windows], major_ms: u64) -> u64 {
        age_of(&path(stations), major_ms) / MS
    }

    fn age_of(stations: &[Station], major_ms: u64) -> u64 {
        age_ns(stations, &worst(stations, major_ms * MS).unwrap())
    }

    fn across(aligned_within_ns: Option<u64>, windows: [Windows; 4]) -> Vec<Station> {
        let mut stations = path(&windows);
        let beside_first_ns = aligned_within_ns.unwrap_or(0);
        stations[2].hop = Some(Hop { latency_ns: MS, aligned_within_ns, beside_first_ns });
        stations
    }

    #[test]
    fn modules_in_one_phase_add_the_latency_and_the_error_of_the_phase() {
        // 1 to 2, relay 3 to 4, one on the way and one for the phase, relay from 6, read from 8 to 9.
        let windows = [every(20, 5, 1, 2), every(20, 5, 3, 4), every(20, 5, 6, 7), every(20, 5, 8, 9)];
        // 8 ms as planned, and the follower may be 1 ms late.
        assert_eq!(age_of(&across(Some(MS), windows.clone()), 100), 9 * MS);
        // With a larger error the datagram may come too late, and that of the frame before is read.
        assert_eq!(age_of(&across(Some(2 * MS), windows), 100), 30 * MS);
    }

    #[test]
    fn modules_without_a_common_phase_add_a_whole_period_of_the_relay() {
        let windows = [every(20, 5, 1, 2), every(20, 5, 3, 4), every(20, 5, 6, 7), every(20, 5, 8, 9)];
        let stations = across(None, windows);
        let way = worst(&stations, 100 * MS).unwrap();
        // 3 ms until the relay's window is over, 20 until the next one is, 1 on the way, 3 from there to the end.
        assert_eq!(age_ns(&stations, &way), 27 * MS);
        assert!(way.windows(2).all(|pair| pair[0].end_ns <= pair[1].start_ns), "{way:?}");
    }

    #[test]
    fn a_relay_with_few_windows_is_waited_for_in_its_longest_pause() {
        let relay = vec![(3 * MS, 4 * MS), (23 * MS, 24 * MS)];
        let windows = [every(20, 5, 1, 2), relay, every(20, 5, 6, 7), every(20, 5, 8, 9)];
        assert_eq!(age_of(&across(None, windows), 100), (3 + 80 + 1 + 3) * MS);
    }

    #[test]
    fn crossings_without_a_common_phase_add_up_each_with_its_own_pause() {
        // Away and back again: relay, network, relay, the station that answers, and the same once more.
        let relay = |start| every(20, 5, start, start + 1);
        let mut stations = path(&[
            every(20, 5, 1, 2),
            relay(3),
            relay(6),
            every(20, 5, 8, 9),
            relay(10),
            relay(15),
            relay(17),
        ]);
        for crossing in [2, 5] {
            stations[crossing].hop =
                Some(Hop { latency_ns: MS, aligned_within_ns: None, beside_first_ns: 0 });
        }
        let way = worst(&stations, 100 * MS).unwrap();
        // 3 + 20 + 1 to the other side, 6 to 11 there, 20 + 1 back, 15 to 18.
        assert_eq!(age_ns(&stations, &way), (3 + 20 + 1 + 5 + 20 + 1 + 3) * MS);
        assert!(way.windows(2).all(|pair| pair[0].end_ns <= pair[1].start_ns), "{way:?}");
    }

    #[test]
    fn a_path_over_two_crossings_of_many_windows_is_followed_in_as_many_steps_not_in_their_cube() {
        // Unless each crossing is sought once, these are 10 000 to the third power steps, which take days.
        let many = || every(20, 10_000, 1, 2);
        let mut stations = path(&[many(), many(), many(), many(), many(), many(), many()]);
        for crossing in [2, 5] {
            stations[crossing].hop =
                Some(Hop { latency_ns: MS, aligned_within_ns: None, beside_first_ns: 0 });
        }
        assert!(worst(&stations, 200_000 * MS).is_some());
    }

    #[test]
    fn windows_in_the_order_of_the_path_take_from_first_opening_to_last_end() {
        let path = [every(20, 5, 1, 2), every(20, 5, 3, 4), every(20, 5, 4, 6)];
        assert_eq!(worst_ms(&path, 100), 5);
    }

    #[test]
    fn a_reader_that_opens_before_the_writer_has_closed_reads_the_frame_before() {
        let (writer, reader) = (every(20, 5, 5, 7), every(20, 5, 6, 8));
        assert_eq!(worst_ms(&[writer.clone(), reader], 100), 23);
        // Touching is soon enough.
        assert_eq!(worst_ms(&[writer, every(20, 5, 7, 8)], 100), 3);
    }

    #[test]
    fn a_slow_writer_is_read_when_it_is_oldest() {
        let writer = vec![(0, MS)];
        assert_eq!(worst_ms(&[writer, every(20, 5, 2, 3)], 100), 83);
    }

    #[test]
    fn a_path_may_begin_several_major_frames_before_its_end() {
        let (one, two, three) = (vec![(9 * MS, 10 * MS)], vec![(5 * MS, 6 * MS)], vec![(MS, 2 * MS)]);
        let stations = path(&[one, two, three]);
        let way = worst(&stations, 10 * MS).unwrap();
        assert_eq!(way[0], Visit { start_ns: -11_000_000, end_ns: -10_000_000 });
        assert_eq!(age_ns(&stations, &way), 13 * MS);
    }

    #[test]
    fn a_path_through_nobody_has_no_age() {
        assert_eq!(worst(&path(&[vec![(0, 1)], vec![]]), 10), None);
        assert_eq!(worst(&path(&[vec![], vec![(0, 1)]]), 10), None);
        assert_eq!(worst(&[], 10), None);
    }

    #[test]
    fn only_channels_lead_to_another_window() {
        let path = [(1, true), (2, false), (2, true), (3, false)];
        assert_eq!(stations(path), [1, 2, 3]);
        assert_eq!(stations([(1, false), (1, true)]), [1]);
        assert_eq!(stations([(1, true), (1, false)]), [1, 1], "to itself: in the window after");
    }
}
