//! Missions with more than way-points to pass, as QGroundControl sends them.

use super::tests::{World, accept, acknowledged, command, count, item, speed, texts, verdicts};
use bateleur_mavlink::common::{
    MISSION_CLEAR_ALL_DATA, MISSION_ITEM_INT_DATA, MISSION_REQUEST_INT_DATA, MISSION_REQUEST_LIST_DATA,
    MISSION_SET_CURRENT_DATA, MavCmd, MavFrame, MavMessage, MavMissionResult as Verdict, MavMissionType,
    MavResult,
};
use bateleur_messages::ground::{Order, Step, Waypoint};
use bateleur_messages::mark::MarkKind;

/// An item with its first four parameters.
fn with(command: MavCmd, params: [f32; 4], place: MISSION_ITEM_INT_DATA) -> MISSION_ITEM_INT_DATA {
    let [param1, param2, param3, param4] = params;
    MISSION_ITEM_INT_DATA { command, param1, param2, param3, param4, ..place }
}

fn without_place(command: MavCmd, params: [f32; 4]) -> MISSION_ITEM_INT_DATA {
    let place =
        MISSION_ITEM_INT_DATA { frame: MavFrame::MAV_FRAME_MISSION, x: 0, y: 0, ..item(0.0, 0.0, 0.0) };
    with(command, params, place)
}

/// From the take-off to the landing.
fn whole_mission() -> Vec<MISSION_ITEM_INT_DATA> {
    use MavCmd as C;
    let nan = f32::NAN;
    vec![
        with(C::MAV_CMD_NAV_TAKEOFF, [15.0, 0.0, 0.0, nan], item(100.0, 0.0, 80.0)),
        speed(24.0),
        item(500.0, 0.0, 160.0),
        with(C::MAV_CMD_NAV_LOITER_TURNS, [2.0, 1.0, -120.0, 1.0], item(500.0, 500.0, 160.0)),
        without_place(C::MAV_CMD_DO_JUMP, [1.0, 2.0, 0.0, 0.0]),
        with(C::MAV_CMD_NAV_LOITER_TIME, [60.0, 0.0, nan, nan], item(0.0, 500.0, 140.0)),
        without_place(C::MAV_CMD_DO_LAND_START, [0.0; 4]),
        with(C::MAV_CMD_NAV_LOITER_TO_ALT, [1.0, 100.0, 0.0, 1.0], item(-300.0, 0.0, 50.0)),
        with(C::MAV_CMD_NAV_LAND, [0.0, 0.0, 0.0, nan], item(20.0, -10.0, 0.0)),
    ]
}

fn loaded(world: &World) -> Vec<Waypoint> {
    let point = |order: &Order| match order {
        Order::Waypoint(point) => Some(*point),
        _ => None,
    };
    world.ordered.iter().filter_map(point).collect()
}

#[test]
fn whole_mission_of_a_ground_station_becomes_the_controllers_list_and_comes_back() {
    let mut world = World::new(accept);
    assert_eq!(world.upload(&whole_mission()), Some(Verdict::MAV_MISSION_ACCEPTED));
    let steps: Vec<_> = loaded(&world).iter().map(|point| (point.step, point.airspeed_mps)).collect();
    let expected = [
        (Step::TakeOff, 22.0),
        (Step::Pass, 24.0),
        (Step::Turns { turns: 2.0, radius_m: -120.0 }, 24.0),
        // To the way-point behind the change of speed.
        (Step::Jump { to: 1, times: 2 }, 24.0),
        (Step::Time { seconds: 60.0, radius_m: 0.0 }, 24.0),
        (Step::Altitude { radius_m: 100.0 }, 24.0),
        (Step::Land, 24.0),
    ];
    assert_eq!(steps, expected);
    let land = loaded(&world)[6];
    assert!((land.north_m - 20.0).abs() < 0.1 && (land.east_m + 10.0).abs() < 0.1 && land.altitude_m == 0.0);

    let ask = |seq| {
        MavMessage::MISSION_REQUEST_INT(MISSION_REQUEST_INT_DATA {
            seq,
            target_system: 1,
            ..MISSION_REQUEST_INT_DATA::DEFAULT
        })
    };
    let heard = world.window(&(0..8).map(ask).collect::<Vec<_>>());
    let back: Vec<_> = heard
        .into_iter()
        .filter_map(|message| match message {
            MavMessage::MISSION_ITEM_INT(item) => {
                Some(MISSION_ITEM_INT_DATA { target_system: 1, target_component: 1, ..item })
            }
            _ => None,
        })
        .collect();
    assert_eq!(back.len(), 8, "all but the mark");
    // What was downloaded is the same mission when it is uploaded again.
    let mut other = World::new(accept);
    assert_eq!(other.upload(&back), Some(Verdict::MAV_MISSION_ACCEPTED));
    let near = |a: &Waypoint, b: &Waypoint| a.distance_m(b) < 0.1 && a.step == b.step;
    assert!(loaded(&world).iter().zip(&loaded(&other)).all(|(a, b)| near(a, b)), "{back:?}");
}

#[test]
fn items_that_would_be_flown_as_something_else_are_refused_with_their_number() {
    use MavCmd as C;
    let first = || item(500.0, 0.0, 100.0);
    let cases = [
        (
            with(C::MAV_CMD_NAV_LOITER_TURNS, [-1.0, 0.0, 0.0, 0.0], first()),
            Verdict::MAV_MISSION_INVALID_PARAM1,
        ),
        (
            with(C::MAV_CMD_NAV_LOITER_TIME, [9e9, 0.0, 0.0, 0.0], first()),
            Verdict::MAV_MISSION_INVALID_PARAM1,
        ),
        (
            with(C::MAV_CMD_NAV_LOITER_UNLIM, [0.0, 0.0, 3.0, 0.0], first()),
            Verdict::MAV_MISSION_INVALID_PARAM3,
        ),
        (
            with(C::MAV_CMD_NAV_LOITER_TO_ALT, [0.0, 2e5, 0.0, 0.0], first()),
            Verdict::MAV_MISSION_INVALID_PARAM2,
        ),
        (with(C::MAV_CMD_NAV_TAKEOFF, [0.0; 4], item(0.0, 0.0, 5.0)), Verdict::MAV_MISSION_INVALID_PARAM7),
        (with(C::MAV_CMD_NAV_LAND, [0.0; 4], item(0.0, 0.0, 40.0)), Verdict::MAV_MISSION_INVALID_PARAM7),
        (without_place(C::MAV_CMD_DO_JUMP, [0.0, 0.0, 0.0, 0.0]), Verdict::MAV_MISSION_INVALID_PARAM2),
        (without_place(C::MAV_CMD_DO_JUMP, [9.0, 1.0, 0.0, 0.0]), Verdict::MAV_MISSION_INVALID_PARAM1),
        (without_place(C::MAV_CMD_DO_SET_SERVO, [0.0; 4]), Verdict::MAV_MISSION_UNSUPPORTED),
    ];
    for (bad, verdict) in cases {
        let mut world = World::new(accept);
        let named = format!("{:?}", bad.command);
        assert_eq!(world.upload(&[item(0.0, 500.0, 100.0), bad]), Some(verdict), "{named}");
        assert!(world.ordered.is_empty(), "{named}");
    }
}

#[test]
fn item_that_is_chosen_is_flown_to_next_by_message_and_by_command() {
    let mut world = World::new(accept);
    world.upload(&whole_mission());
    world.ordered.clear();
    let choose = |seq| {
        MavMessage::MISSION_SET_CURRENT(MISSION_SET_CURRENT_DATA {
            seq,
            target_system: 1,
            ..MISSION_SET_CURRENT_DATA::DEFAULT
        })
    };
    // As they are numbered in a download, which has the speed and not the mark: 5 is the circle for a time.
    world.window(&[choose(5)]);
    assert_eq!(world.ordered, [Order::GoOnWith { index: 4 }]);
    let heard = world.window(&[command(MavCmd::MAV_CMD_DO_SET_MISSION_CURRENT, 1.0)]);
    assert_eq!(world.ordered[1..], [Order::GoOnWith { index: 1 }], "a speed is the way-point behind it");
    assert_eq!(acknowledged(&heard), [MavResult::MAV_RESULT_ACCEPTED]);
    let heard = world.window(&[choose(40)]);
    assert_eq!(verdicts(&heard), [Verdict::MAV_MISSION_INVALID_SEQUENCE]);
    assert!(texts(&heard).contains("no such item"));
    for none in [40.0, -1.0, f32::NAN] {
        let heard = world.window(&[command(MavCmd::MAV_CMD_DO_SET_MISSION_CURRENT, none)]);
        assert_eq!(acknowledged(&heard), [MavResult::MAV_RESULT_DENIED], "{none}");
    }
    assert_eq!(world.ordered.len(), 2);
}

/// Every message is lost one time in three, in both directions.
#[test]
fn upload_over_a_line_that_loses_messages_arrives_whole() {
    for seed in 0..40_u64 {
        let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
        let mut lost = || {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            state % 3 == 0
        };
        let (items, mut world) = (whole_mission(), World::new(accept));
        let begin = count(items.len() as u16, MavMissionType::MAV_MISSION_TYPE_MISSION);
        let (mut verdict, mut asked) = (None, false);
        let mut answers = Vec::new();
        for window in 0..20_000 {
            // A ground station begins again where nobody has asked for an item.
            if !asked && window % 75 == 0 {
                answers.push(begin.clone());
            }
            answers.retain(|_| !lost());
            let heard = world.window(&std::mem::take(&mut answers));
            for message in heard {
                match message {
                    MavMessage::MISSION_REQUEST_INT(request) if !lost() => {
                        asked = true;
                        let item = items[usize::from(request.seq)].clone();
                        answers.push(MavMessage::MISSION_ITEM_INT(MISSION_ITEM_INT_DATA {
                            seq: request.seq,
                            ..item
                        }));
                    }
                    MavMessage::MISSION_ACK(ack) => verdict = verdict.or(Some(ack.mavtype)),
                    _ => {}
                }
            }
            if verdict == Some(Verdict::MAV_MISSION_OPERATION_CANCELLED) {
                // Five times in a row nothing came through: the ground station begins anew.
                (verdict, asked) = (None, false);
            }
            if verdict.is_some() {
                break;
            }
        }
        assert_eq!(verdict, Some(Verdict::MAV_MISSION_ACCEPTED), "seed {seed}");
        assert_eq!(world.station.mission().len(), 7, "seed {seed}");
    }
}

/// A polygon, a circle to stay out of.
fn fence() -> Vec<MISSION_ITEM_INT_DATA> {
    let corner = |north, east| {
        let place = MISSION_ITEM_INT_DATA { frame: MavFrame::MAV_FRAME_GLOBAL, ..item(north, east, 0.0) };
        with(MavCmd::MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION, [3.0, 0.0, 0.0, 0.0], place)
    };
    let circle =
        with(MavCmd::MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION, [150.0, 0.0, 0.0, 0.0], item(400.0, 300.0, 0.0));
    vec![corner(-500.0, -500.0), corner(2000.0, 0.0), corner(0.0, 2000.0), circle]
}

fn rally() -> Vec<MISSION_ITEM_INT_DATA> {
    [(300.0, 0.0), (0.0, 800.0)]
        .map(|(north, east)| with(MavCmd::MAV_CMD_NAV_RALLY_POINT, [0.0; 4], item(north, east, 90.0)))
        .to_vec()
}

#[test]
fn fence_and_rally_points_go_to_the_controller_come_back_and_are_cleared() {
    use MavMissionType as T;
    let mut world = World::new(accept);
    world.upload(&whole_mission());
    for (kind, items) in [(T::MAV_MISSION_TYPE_FENCE, fence()), (T::MAV_MISSION_TYPE_RALLY, rally())] {
        world.ordered.clear();
        assert_eq!(world.upload_of(kind, &items), Some(Verdict::MAV_MISSION_ACCEPTED));
        let marks: Vec<_> = world
            .ordered
            .iter()
            .map(|order| match order {
                Order::Fence(mark) | Order::Rally(mark) => *mark,
                other => panic!("{other:?}"),
            })
            .collect();
        assert!(marks.iter().zip(0..).all(|(mark, index)| (mark.index, mark.list) == (index, marks[0].list)));
        assert_eq!(marks.iter().map(|mark| usize::from(mark.count)).max(), Some(items.len()));
        if kind == T::MAV_MISSION_TYPE_FENCE {
            let kinds: Vec<_> = marks.iter().map(|mark| (mark.kind, mark.size)).collect();
            let corner = (MarkKind::InclusionCorner, 3.0);
            assert_eq!(kinds, [corner, corner, corner, (MarkKind::ExclusionCircle, 150.0)]);
        }
        let list = MavMessage::MISSION_REQUEST_LIST(MISSION_REQUEST_LIST_DATA {
            target_system: 1,
            mission_type: kind,
            ..MISSION_REQUEST_LIST_DATA::DEFAULT
        });
        let ask = |seq| {
            MavMessage::MISSION_REQUEST_INT(MISSION_REQUEST_INT_DATA {
                seq,
                target_system: 1,
                mission_type: kind,
                ..MISSION_REQUEST_INT_DATA::DEFAULT
            })
        };
        let questions: Vec<_> =
            std::iter::once(list.clone()).chain((0..items.len() as u16).map(ask)).collect();
        let heard = world.window(&questions);
        let back = heard.iter().filter_map(|message| match message {
            MavMessage::MISSION_ITEM_INT(item) => {
                Some((item.command, item.param1, item.z, item.mission_type))
            }
            _ => None,
        });
        let sent = items.iter().map(|item| (item.command, item.param1, item.z, kind));
        assert_eq!(back.collect::<Vec<_>>(), sent.collect::<Vec<_>>());
        let clear = MavMessage::MISSION_CLEAR_ALL(MISSION_CLEAR_ALL_DATA {
            target_system: 1,
            mission_type: kind,
            ..MISSION_CLEAR_ALL_DATA::DEFAULT
        });
        assert_eq!(verdicts(&world.window(&[clear])), [Verdict::MAV_MISSION_ACCEPTED]);
        let heard = world.window(&[list]);
        let none = |message: &MavMessage| matches!(message, MavMessage::MISSION_COUNT(m) if m.count == 0);
        assert!(heard.iter().any(none), "{kind:?}");
    }
    assert_eq!(world.station.mission().len(), 7, "the mission stays");
}

#[test]
fn fence_items_that_make_no_sense_are_refused_and_a_fence_that_the_controller_refuses_is_told() {
    use MavCmd as C;
    let fence_kind = MavMissionType::MAV_MISSION_TYPE_FENCE;
    let place = || item(100.0, 0.0, 0.0);
    let cases = [
        (with(C::MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION, [0.0; 4], place()), Verdict::MAV_MISSION_INVALID_PARAM1),
        (
            with(C::MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION, [2.0, 0.0, 0.0, 0.0], place()),
            Verdict::MAV_MISSION_INVALID_PARAM1,
        ),
        (with(C::MAV_CMD_NAV_FENCE_RETURN_POINT, [0.0; 4], place()), Verdict::MAV_MISSION_UNSUPPORTED),
        (with(C::MAV_CMD_NAV_RALLY_POINT, [0.0; 4], place()), Verdict::MAV_MISSION_UNSUPPORTED),
        (place(), Verdict::MAV_MISSION_UNSUPPORTED),
    ];
    for (bad, verdict) in cases {
        let mut world = World::new(accept);
        let named = format!("{:?}", bad.command);
        assert_eq!(world.upload_of(fence_kind, &[bad]), Some(verdict), "{named}");
        assert!(world.ordered.is_empty(), "{named}");
    }
    let mut world = World::new(super::tests::refuse);
    assert_eq!(world.upload_of(fence_kind, &fence()), Some(Verdict::MAV_MISSION_DENIED));
    let mut world = World::new(|_| Vec::new());
    assert_eq!(world.upload_of(fence_kind, &fence()), Some(Verdict::MAV_MISSION_ERROR));
    let many = vec![fence()[3].clone(); 33];
    assert_eq!(World::new(accept).upload_of(fence_kind, &many), Some(Verdict::MAV_MISSION_NO_SPACE));
}
