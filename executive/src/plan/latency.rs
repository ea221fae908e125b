//! How old a value is at the end of a path through windows.
//!
//! The rule of sampling: a partition may write at any instant of its window, so what it writes is counted on only
//! by windows that open when that window has closed, or later. From each window of the last partition the path is
//! followed back by that rule; the oldest value over a whole major frame is the bound. Where windows on two cores
//! overlap, the reader may in fact see a newer value, never an older one.
//!
//! All of this holds while every window is granted, on time, and used. It must never take the present into account.

/// One partition's windows in a major frame: start and end in nanoseconds, in any order, none overlapping another.
pub(super) type Windows = Vec<(u64, u64)>;

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
pub(super) fn ways(stations: &[Windows], major_ns: u64) -> Vec<Vec<Visit>> {
    let Some((last, before)) = stations.split_last() else { return Vec::new() };
    let Ok(major) = i64::try_from(major_ns) else { return Vec::new() };
    if major == 0 {
        return Vec::new();
    }
    let before: Vec<Windows> = before.iter().map(sorted).collect();
    let way = |&(start, end): &(u64, u64)| {
        let last = Visit { start_ns: i64::try_from(start).ok()?, end_ns: i64::try_from(end).ok()? };
        let mut visits = vec![last];
        for windows in before.iter().rev() {
            visits.push(latest_closed(windows, visits.last()?.start_ns, major)?);
        }
        visits.reverse();
        Some(visits)
    };
    last.iter().filter_map(way).collect()
}

/// From the opening of the first window to the end of the last.
pub(super) fn age_ns(way: &[Visit]) -> u64 {
    let (Some(first), Some(last)) = (way.first(), way.last()) else { return 0 };
    last.end_ns.abs_diff(first.start_ns)
}

/// The way with the oldest value at its end; none where a station has no window.
pub(super) fn worst(stations: &[Windows], major_ns: u64) -> Option<Vec<Visit>> {
    // The first of equals, so that the answer is the same every time.
    ways(stations, major_ns).into_iter().rev().max_by_key(|way| age_ns(way))
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

    fn worst_ms(stations: &[Windows], major_ms: u64) -> u64 {
        age_ns(&worst(stations, major_ms * MS).unwrap()) / MS
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
        let way = worst(&[one, two, three], 10 * MS).unwrap();
        assert_eq!(way[0], Visit { start_ns: -11_000_000, end_ns: -10_000_000 });
        assert_eq!(age_ns(&way), 13 * MS);
    }

    #[test]
    fn a_path_through_nobody_has_no_age() {
        assert_eq!(worst(&[vec![(0, 1)], vec![]], 10), None);
        assert_eq!(worst(&[vec![], vec![(0, 1)]], 10), None);
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
