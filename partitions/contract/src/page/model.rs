use loom::sync::Arc;
use loom::sync::atomic::AtomicBool;
use loom::thread;

use super::*;
use crate::sync::explore;

#[test]
fn model_control_page_a_grant_is_taken_whole_whenever_the_next_one_comes() {
    explore(|| {
        let page = Arc::new(ControlPage::default());
        let window = |number: u32| WindowGrant {
            start_ns: number.into(),
            major_frame_ns: number.into(),
            schedule: number,
            ..WindowGrant::default()
        };
        let executive = {
            let page = page.clone();
            thread::spawn(move || page.publish_grant(1, &window(1)))
        };
        if let Some((number, granted)) = page.try_granted_window() {
            assert_eq!(granted, window(number));
        }
        executive.join().unwrap();
        assert_eq!(page.try_granted_window(), Some((1, window(1))));
    });
}

#[test]
fn model_control_page_whoever_sleeps_until_a_window_is_closed_is_woken_or_sees_it() {
    explore(|| {
        let page = Arc::new(ControlPage::default());
        let woken = Arc::new(AtomicBool::new(false));
        let partition = {
            let (page, woken) = (page.clone(), woken.clone());
            thread::spawn(move || {
                if page.close(1) {
                    woken.store(true, Ordering::SeqCst);
                }
            })
        };
        let sleeps = page.await_close() != 1;
        partition.join().unwrap();
        assert!(!sleeps || woken.load(Ordering::SeqCst), "the dispatcher sleeps, and nobody wakes it");
        page.awake();
    });
}

#[test]
fn model_control_page_what_is_told_of_the_alignment_is_one_report() {
    explore(|| {
        let page = Arc::new(ControlPage::default());
        let report = |number: u32| AlignmentReport {
            peer_minus_own_ns: number.into(),
            uncertainty_ns: number,
            exchanges: number,
        };
        let partition = {
            let page = page.clone();
            thread::spawn(move || (1..3).for_each(|number| page.tell_alignment(&report(number))))
        };
        let mut seen = 0;
        if let Some(told) = page.alignment_since(&mut seen) {
            assert_eq!(told.report, report(told.report.exchanges));
        }
        partition.join().unwrap();
    });
}
