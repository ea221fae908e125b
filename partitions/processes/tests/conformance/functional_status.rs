//! Functional status of data.

use bateleur_processes::functional_status::FunctionalStatus::{self, *};
use bateleur_processes::functional_status::{functional_status_of, status_bytes};
use bateleur_processes::standard::Validity;

#[test]
fn fss_01_each_status_has_its_byte() {
    let bytes = [NoData, NormalOperation, FunctionalTest, NoComputedData].map(|status| status as u8);
    assert_eq!(bytes, [0x00, 0x03, 0x0C, 0x30]);
}

#[test]
fn fss_02_any_other_byte_is_no_data() {
    for byte in 0..=u8::MAX {
        let status = FunctionalStatus::of_byte(byte);
        assert_eq!(status as u8, if [0x03, 0x0C, 0x30].contains(&byte) { byte } else { 0 }, "{byte:#x}");
    }
}

#[test]
fn fss_03_four_bytes_come_before_four_sets_and_those_that_are_not_there_have_no_data() {
    assert_eq!(status_bytes(&[NormalOperation, FunctionalTest]), [0x03, 0x0C, 0, 0]);
    let mut message =
        status_bytes(&[NoComputedData, NormalOperation, FunctionalTest, NormalOperation]).to_vec();
    message.extend([0x03; 8]);
    let found = functional_status_of(&message, Validity::Valid);
    assert_eq!(found, [NoComputedData, NormalOperation, FunctionalTest, NormalOperation]);
    assert_eq!(functional_status_of(&message[..3], Validity::Valid), [NoData; 4], "it has no room for them");
}

#[test]
fn fss_04_data_is_used_in_normal_operation_and_for_a_test_in_a_test() {
    let used = |in_a_test| {
        [NoData, NormalOperation, FunctionalTest, NoComputedData].map(|status| status.may_be_used(in_a_test))
    };
    assert_eq!((used(false), used(true)), ([false, true, false, false], [false, true, true, false]));
}

#[test]
fn fss_05_stale_port_has_no_data() {
    let message = status_bytes(&[NormalOperation; 4]);
    assert_eq!(functional_status_of(&message, Validity::Invalid), [NoData; 4]);
}
