//! Retained memory: what a partition's next incarnation shall find again after a warm restart.
//!
//! The executive holds the memory across incarnations; it is zero after a cold start. Two copies are written in
//! turn, each with its number last, so that a partition killed in the middle of a store leaves the copy before. Both lie
//! behind one another and go in one write, which the kernel carries out from front to back: a store is one system call.

use std::fs::File;
use std::marker::PhantomData;
use std::os::unix::fs::FileExt;

use bateleur_contract::ReportKind;
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

use crate::context::StartError;
use crate::time::Time;

/// Bytes behind each copy: its number, the size of the value.
const TRAILER: u64 = 16;

/// A value of plain data that outlives its partition.
#[derive(Debug)]
pub struct Retained<T> {
    file: Option<File>,
    number: u64,
    /// A copy as it is written.
    copy: Vec<u8>,
    /// The copy is what this incarnation has stored last.
    stored: bool,
    time: Time,
    value: PhantomData<T>,
}

impl<T: FromBytes + IntoBytes + Immutable + KnownLayout> Retained<T> {
    /// The memory behind `file`, `bytes` long. Without memory, nothing is retained.
    pub(crate) fn new(file: Option<File>, bytes: u64, time: Time) -> Result<Self, StartError> {
        let needed = 2 * slot_bytes::<T>();
        if file.is_some() && bytes < needed {
            return Err(StartError::Other(format!(
                "retained = \"{bytes}\" is too small: this partition keeps {needed} bytes"
            )));
        }
        let copy = vec![0; (trailer_at::<T>() + TRAILER) as usize];
        Ok(Self { file, number: 0, copy, stored: false, time, value: PhantomData })
    }

    /// What the incarnation before stored last.
    pub fn load(&mut self) -> Option<T> {
        let file = self.file.as_ref()?;
        let newest =
            (0..2).filter_map(|slot| number_in::<T>(file, slot).map(|number| (number, slot))).max()?;
        self.number = newest.0;
        let mut value = T::new_zeroed();
        file.read_exact_at(value.as_mut_bytes(), newest.1 * slot_bytes::<T>()).ok()?;
        Some(value)
    }

    /// Keeps `value` for the next incarnation.
    pub fn store(&mut self, value: &T) {
        let Some(file) = &self.file else { return };
        let front = &self.copy[..size_of::<T>()];
        if self.stored && front == value.as_bytes() {
            return; // it is there already: looking is a fraction of a system call
        }
        self.stored = true;
        self.number += 1;
        let at = (self.number % 2) * slot_bytes::<T>();
        let trailer = [self.number, size_of::<T>() as u64];
        let (front, back) = self.copy.split_at_mut(trailer_at::<T>() as usize);
        front[..size_of::<T>()].copy_from_slice(value.as_bytes());
        back.copy_from_slice(trailer.as_bytes());
        if let Err(error) = file.write_all_at(&self.copy, at) {
            self.file = None; // memory that the executive took away: go on without
            let text = format!("retained memory can not be written ({error}): nothing is kept any more");
            self.time.page().report(ReportKind::Message, &text);
        }
    }
}

const fn slot_bytes<T>() -> u64 {
    TRAILER + (size_of::<T>() as u64).next_multiple_of(64)
}

/// Where in a slot the trailer begins: behind the value.
const fn trailer_at<T>() -> u64 {
    (size_of::<T>() as u64).next_multiple_of(size_of::<u64>() as u64)
}

fn number_in<T>(file: &File, slot: u64) -> Option<u64> {
    let mut trailer = [0_u64; 2];
    file.read_exact_at(trailer.as_mut_bytes(), slot * slot_bytes::<T>() + trailer_at::<T>()).ok()?;
    let [number, size] = trailer;
    (number > 0 && size == size_of::<T>() as u64).then_some(number)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn memory() -> File {
        let file = tempfile::tempfile().unwrap();
        file.set_len(4096).unwrap();
        file
    }

    fn retained(file: &File) -> Retained<[f64; 3]> {
        Retained::new(Some(file.try_clone().unwrap()), 4096, Time::standing()).unwrap()
    }

    #[test]
    fn zero_memory_holds_nothing() {
        assert_eq!(retained(&memory()).load(), None);
    }

    #[test]
    fn the_next_incarnation_finds_the_last_value() {
        let file = memory();
        let mut first = retained(&file);
        for number in 0..5 {
            first.store(&[f64::from(number); 3]);
        }
        let mut second = retained(&file);
        assert_eq!(second.load(), Some([4.0; 3]));
        second.store(&[9.0; 3]);
        assert_eq!(retained(&file).load(), Some([9.0; 3]));
    }

    #[test]
    fn memory_that_can_not_be_written_any_more_is_reported_once_and_the_partition_goes_on() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("memory");
        std::fs::write(&path, [0; 4096]).unwrap();
        let time = Time::standing();
        let mut retained = Retained::new(Some(File::open(&path).unwrap()), 4096, time.clone()).unwrap();
        retained.store(&[1.0_f64; 3]);
        retained.store(&[2.0; 3]);
        let reports = time.page().reports_since(&mut 0);
        assert!(reports.len() == 1 && reports[0].text.contains("nothing is kept"), "{reports:?}");
    }

    #[test]
    fn a_successor_does_not_take_its_first_value_for_one_that_it_has_stored() {
        let file = memory();
        retained(&file).store(&[5.0; 3]);
        let mut second = retained(&file);
        second.load();
        second.store(&[0.0; 3]);
        assert_eq!(retained(&file).load(), Some([0.0; 3]));
    }

    #[test]
    fn a_store_cut_short_leaves_the_value_before() {
        let file = memory();
        let mut first = retained(&file);
        first.store(&[1.0; 3]);
        first.store(&[2.0; 3]);
        // The third store is killed after half of the value and before the number.
        file.write_all_at(&[0xff; 12], slot_bytes::<[f64; 3]>()).unwrap();
        assert_eq!(retained(&file).load(), Some([2.0; 3]));
    }

    #[test]
    fn a_value_whose_size_is_no_whole_number_of_words_comes_back_whole() {
        let file = memory();
        let open =
            || Retained::<[u8; 13]>::new(Some(file.try_clone().unwrap()), 4096, Time::standing()).unwrap();
        let mut first = open();
        (1..4).for_each(|number| first.store(&[number; 13]));
        assert_eq!(open().load(), Some([3; 13]));
    }

    #[test]
    fn memory_that_is_too_small_is_refused_with_the_size_that_is_needed() {
        let error = Retained::<[f64; 3]>::new(Some(memory()), 100, Time::standing()).unwrap_err();
        assert!(error.to_string().contains("160 bytes"), "{error}");
    }
}
