use super::*;

fn page() -> crate::Mapped<ControlPage> {
    let file = rustix::fs::memfd_create("page", rustix::fs::MemfdFlags::empty()).unwrap();
    rustix::fs::ftruncate(&file, 4096).unwrap();
    crate::Mapped::new(file).unwrap()
}

#[test]
fn a_page_of_zeros_is_not_a_control_page() {
    let page = page();
    assert!(!page.is_valid());
    page.initialise();
    assert!(page.is_valid());
}

#[test]
fn a_page_that_is_too_short_is_refused_instead_of_a_bus_error() {
    let file = rustix::fs::memfd_create("page", rustix::fs::MemfdFlags::empty()).unwrap();
    assert!(matches!(
        crate::Mapped::<ControlPage>::new(file),
        Err(crate::MappingError::TooShort { found: 0, .. })
    ));
}

#[test]
fn nobody_is_woken_who_does_not_sleep() {
    let page = page();
    assert!(!page.close(1));
    assert_eq!(page.await_close(), 1);
    assert!(page.close(2));
    page.awake();
    assert!(!page.close(3));
}

#[test]
fn reports_come_in_order_and_long_ones_are_cut_at_a_character() {
    let page = page();
    let mut seen = 0;
    page.report(ReportKind::Message, "one");
    page.report(ReportKind::ApplicationError, &"ä".repeat(100));
    let reports = page.reports_since(&mut seen);
    let one = Reported { kind: ReportKind::Message, in_handler: false, text: "one".into() };
    assert_eq!(reports[0], one);
    assert_eq!(reports[1].text, "ä".repeat(64));
    assert!(page.reports_since(&mut seen).is_empty());
}

#[test]
fn ordered_faults_are_found_once_each_in_their_order_and_the_newest_of_too_many() {
    let (page, mut seen) = (page(), 0);
    assert_eq!(page.fault_since(&mut seen), None);
    let order = |kind, argument| FaultOrder { kind, port: 3, messages: 7, argument };
    page.order_fault(&order(FaultKind::Delay, 1));
    page.order_fault(&order(FaultKind::Drop, u64::MAX));
    assert_eq!(page.fault_since(&mut seen), Some(order(FaultKind::Delay, 1)));
    assert_eq!(page.fault_since(&mut seen), Some(order(FaultKind::Drop, u64::MAX)));
    assert_eq!(page.fault_since(&mut seen), None);
    (0..2 * FAULTS as u64).for_each(|number| page.order_fault(&order(FaultKind::Corrupt, number)));
    let found: Vec<_> =
        std::iter::from_fn(|| page.fault_since(&mut seen)).map(|order| order.argument).collect();
    assert_eq!(found, (FAULTS as u64..2 * FAULTS as u64).collect::<Vec<_>>());
    // A partition that has written over its page: no kind is made up.
    page.fault_orders.store(u32::MAX, Ordering::Relaxed);
    page.faults.iter().for_each(|fault| fault.kind.store(u32::MAX, Ordering::Relaxed));
    assert_eq!(page.fault_since(&mut seen), None);
    page.order_fault(&order(FaultKind::Drop, 5));
    assert_eq!(page.fault_since(&mut seen), Some(order(FaultKind::Drop, 5)), "the next one is found");
}

#[test]
fn what_is_told_of_the_alignment_is_found_once_with_its_major_frame() {
    let (page, mut seen) = (page(), 0);
    assert_eq!(page.alignment_since(&mut seen), None);
    let report = AlignmentReport { peer_minus_own_ns: -1_234, uncertainty_ns: 77, exchanges: 3 };
    page.major_frame.store(9, Ordering::Relaxed);
    page.tell_alignment(&report);
    page.major_frame.store(10, Ordering::Relaxed);
    assert_eq!(page.alignment_since(&mut seen), Some(AlignmentTold { report, major_frame: 9 }));
    assert_eq!(page.alignment_since(&mut seen), None);
}

#[test]
fn half_a_report_of_the_alignment_is_none_and_its_successor_mends_it() {
    let (page, mut seen) = (page(), 0);
    page.alignment_count.store(1, Ordering::Relaxed); // it died while it wrote
    assert_eq!(page.alignment_since(&mut seen), None);
    page.tell_alignment(&AlignmentReport::default());
    assert!(page.alignment_since(&mut seen).is_some());
}

#[test]
fn a_flood_of_reports_keeps_the_newest() {
    let page = page();
    (0..20).for_each(|number| page.report(ReportKind::Message, &number.to_string()));
    let reports = page.reports_since(&mut 0);
    assert_eq!((reports.len(), reports[0].text.as_str(), reports[7].text.as_str()), (8, "12", "19"));
}

#[test]
fn report_that_is_written_just_now_is_not_counted_with_the_words_of_another_one() {
    let (page, mut seen) = (page(), 0);
    (0..8).for_each(|number| page.report(ReportKind::Message, &number.to_string()));
    // The partition is in the middle of a ninth, which has the place of the first.
    page.report_ring().add(|place| {
        place.write(ReportKind::ApplicationError as u32, "half of the ninth");
        let texts: Vec<_> = page.reports_since(&mut seen).into_iter().map(|report| report.text).collect();
        assert_eq!(texts, ["1", "2", "3", "4", "5", "6", "7"]);
    });
    assert_eq!(page.reports_since(&mut seen).len(), 1, "and the ninth once");
}

#[test]
fn fault_that_is_ordered_just_now_is_not_carried_out_in_pieces() {
    let (page, mut seen) = (page(), 0);
    let order = |argument| FaultOrder { kind: FaultKind::Corrupt, port: 0, messages: 1, argument };
    (0..8).for_each(|number| page.order_fault(&order(number)));
    page.fault_ring().add(|place| {
        place.argument.store(77, Ordering::Relaxed);
        let found = std::iter::from_fn(|| page.fault_since(&mut seen)).map(|order| order.argument);
        assert_eq!(found.collect::<Vec<_>>(), [1, 2, 3, 4, 5, 6, 7]);
    });
}

#[test]
fn window_that_is_granted_just_now_is_not_taken_with_the_times_of_another_one() {
    let page = page();
    let window = |number: u64| WindowGrant { start_ns: number, end_ns: number + 1, ..Default::default() };
    page.publish_grant(1, &window(1));
    assert_eq!(page.try_granted_window(), Some((1, window(1))));
    // The executive has lost its processor within the second grant.
    page.begin_grant(2);
    page.window_start_ns.store(2, Ordering::Relaxed);
    assert_eq!(page.try_granted_window(), None);
    page.publish_grant(2, &window(2));
    assert_eq!(page.granted_window(), (2, window(2)));
}

#[test]
fn windows_that_are_granted_while_another_thread_takes_them_are_whole() {
    let page = page();
    let whole = |number: u64| WindowGrant {
        start_ns: number,
        end_ns: number,
        minor_frames: number,
        minor_frame_ns: number,
        major_frame: number,
        major_frame_ns: number,
        schedule: number as u32,
        next_schedule: number as u32,
        schedule_since_ns: number,
    };
    const GRANTS: u32 = 200_000;
    std::thread::scope(|scope| {
        scope.spawn(|| (1..=GRANTS).for_each(|number| page.publish_grant(number, &whole(number.into()))));
        let mut last = 0;
        while last < GRANTS {
            let (number, window) = page.granted_window();
            assert!(number >= last);
            assert_eq!(window, whole(number.into()));
            last = number;
        }
    });
}

#[test]
fn a_report_of_an_error_handler_says_so() {
    let page = page();
    page.handling.store(1, Ordering::Relaxed);
    page.report(ReportKind::PortError, "again");
    let report = &page.reports_since(&mut 0)[0];
    assert_eq!((report.kind, report.in_handler), (ReportKind::PortError, true));
}

#[test]
fn entries_of_the_health_log_come_in_order_and_those_of_a_flood_are_counted() {
    let (page, mut seen, mut lost) = (page(), 0, 0);
    page.notify(3, "one");
    assert_eq!(page.next_notice(&mut seen, &mut lost), Some((3, "one".into())));
    assert_eq!(page.next_notice(&mut seen, &mut lost), None);
    (0..20).for_each(|number| page.notify(4, &number.to_string()));
    let texts: Vec<_> = std::iter::from_fn(|| Some(page.next_notice(&mut seen, &mut lost)?.1)).collect();
    assert_eq!((texts.len(), texts[0].as_str(), texts[7].as_str(), lost), (8, "12", "19", 12));
}

#[test]
fn errors_for_the_handler_come_in_order_and_a_flood_keeps_the_newest() {
    let (page, mut seen) = (page(), 0);
    page.raise(ErrorCode::DeadlineMissed, "late");
    assert_eq!(page.next_error(&mut seen), Some((ErrorCode::DeadlineMissed, "late".into())));
    assert_eq!(page.next_error(&mut seen), None);
    (0..20).for_each(|number| page.raise(ErrorCode::ApplicationError, &number.to_string()));
    let texts: Vec<_> = std::iter::from_fn(|| Some(page.next_error(&mut seen)?.1)).collect();
    assert_eq!((texts.len(), texts[0].as_str(), texts[7].as_str()), (8, "12", "19"));
}

#[test]
fn error_that_is_written_over_just_now_is_not_handed_to_the_handler_in_pieces() {
    let (page, mut seen) = (page(), 0);
    (0..8).for_each(|number| page.raise(ErrorCode::ApplicationError, &number.to_string()));
    // The executive is in the middle of a ninth, which has the place of the first.
    page.error_ring().add(|place| {
        place.write(ErrorCode::DeadlineMissed as u32, "half of the ninth");
        let texts: Vec<_> = std::iter::from_fn(|| Some(page.next_error(&mut seen)?.1)).collect();
        assert_eq!(texts, ["1", "2", "3", "4", "5", "6", "7"]);
    });
}
