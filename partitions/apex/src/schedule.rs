//! Module schedules: SET_MODULE_SCHEDULE, GET_MODULE_SCHEDULE_STATUS, GET_MODULE_SCHEDULE_ID (ARINC 653 part 2).

use std::rc::Rc;
use std::sync::atomic::Ordering::Acquire;
use std::sync::{Mutex, PoisonError};

use bateleur_contract::ControlPage;
use bateleur_processes::ReturnCode;

use crate::time::Time;

/// A schedule of the plan, by its place in it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ScheduleId(pub u32);

/// What GET_MODULE_SCHEDULE_STATUS gives.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ScheduleStatus {
    /// TIME_OF_LAST_SCHEDULE_SWITCH, module time, ns; 0: the module has not changed yet.
    pub time_of_last_switch_ns: u64,
    /// CURRENT_SCHEDULE.
    pub current: ScheduleId,
    /// NEXT_SCHEDULE: that of the next major frame; the current one where none is pending.
    pub next: ScheduleId,
}

/// What the plan says of schedules, and what was asked for.
#[derive(Debug, Default)]
pub(crate) struct Schedules {
    names: Box<[String]>,
    permitted_in: Box<[u32]>,
    /// What was asked for in a window, and the number of that window's grant: the executive takes it at the window's end.
    asked: Mutex<Option<(u32, u32)>>,
}

impl Schedules {
    pub(crate) fn new(names: &[String], permitted_in: &[u32]) -> Self {
        Self { names: names.into(), permitted_in: permitted_in.into(), asked: Mutex::default() }
    }

    pub(crate) fn id(&self, name: &str) -> Result<ScheduleId, ReturnCode> {
        let place = self.names.iter().position(|known| known == name);
        place.map(|place| ScheduleId(place as u32)).ok_or(ReturnCode::InvalidConfig)
    }

    pub(crate) fn status(&self, page: &ControlPage) -> ScheduleStatus {
        let (window, granted) = page.granted_window();
        let next = match *self.asked.lock().unwrap_or_else(PoisonError::into_inner) {
            Some((in_window, schedule)) if in_window == window => schedule,
            _ => granted.next_schedule,
        };
        ScheduleStatus {
            time_of_last_switch_ns: granted.schedule_since_ns,
            current: ScheduleId(granted.schedule),
            next: ScheduleId(next),
        }
    }

    pub(crate) fn set(&self, page: &ControlPage, schedule: ScheduleId) -> Result<(), ReturnCode> {
        let status = self.status(page);
        if !self.permitted_in.contains(&status.current.0) {
            return Err(ReturnCode::InvalidConfig);
        }
        if schedule.0 as usize >= self.names.len() {
            return Err(ReturnCode::InvalidParam);
        }
        if schedule == status.current && status.next == status.current {
            return Err(ReturnCode::NoAction);
        }
        page.request_schedule(schedule.0);
        let asked = Some((page.grant.load(Acquire), schedule.0));
        *self.asked.lock().unwrap_or_else(PoisonError::into_inner) = asked;
        Ok(())
    }
}

/// The module's schedules, as this partition may see and set them. Cheap to clone.
#[derive(Debug, Clone)]
pub struct ModuleSchedules {
    time: Time,
    schedules: Rc<Schedules>,
}

impl ModuleSchedules {
    pub(crate) fn new(time: Time, schedules: Schedules) -> Self {
        Self { time, schedules: schedules.into() }
    }

    /// GET_MODULE_SCHEDULE_ID.
    ///
    /// # Errors
    /// INVALID_CONFIG: the plan has no such schedule.
    pub fn get_module_schedule_id(&self, name: &str) -> Result<ScheduleId, ReturnCode> {
        self.schedules.id(name)
    }

    /// GET_MODULE_SCHEDULE_STATUS, as it was when the window was granted, and with what this partition has asked for since.
    #[must_use]
    pub fn get_module_schedule_status(&self) -> ScheduleStatus {
        self.schedules.status(self.time.page())
    }

    /// SET_MODULE_SCHEDULE: the module changes to `schedule` at the start of the next major frame. The last request
    /// before that wins, whoever makes it; asking for the current schedule calls a pending one off.
    ///
    /// # Errors
    /// INVALID_CONFIG: this partition may not ask, in this schedule. INVALID_PARAM: there is no such schedule.
    /// NO_ACTION: it runs already, and no other is pending.
    pub fn set_module_schedule(&self, schedule: ScheduleId) -> Result<(), ReturnCode> {
        self.schedules.set(self.time.page(), schedule)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bateleur_contract::page::WindowGrant;
    use bateleur_contract::{Clock, Mapped};

    fn schedules(permitted_in: &[u32]) -> ModuleSchedules {
        let file = rustix::fs::memfd_create("page", rustix::fs::MemfdFlags::CLOEXEC).unwrap();
        rustix::fs::ftruncate(&file, size_of::<ControlPage>() as u64).unwrap();
        let page = Mapped::<ControlPage>::new(file).unwrap();
        page.initialise();
        let names = ["flight", "ground", "test"].map(str::to_owned).to_vec();
        ModuleSchedules::new(Time::new(Rc::new(page), Clock::Virtual), Schedules::new(&names, permitted_in))
    }

    /// A window in `schedule`, granted while `next` was to come.
    fn grant(schedules: &ModuleSchedules, schedule: u32, next: u32, since_ns: u64) {
        let page = schedules.time.page();
        let window = WindowGrant {
            schedule,
            next_schedule: next,
            schedule_since_ns: since_ns,
            ..WindowGrant::default()
        };
        page.publish_grant(page.grant.load(Acquire) + 1, &window);
    }

    #[test]
    fn mms_id_02_name_of_a_schedule_gives_its_identifier() {
        let schedules = schedules(&[]);
        let found = ["flight", "ground", "test"].map(|name| schedules.get_module_schedule_id(name));
        assert_eq!(found, [0, 1, 2].map(|place| Ok(ScheduleId(place))));
    }

    #[test]
    fn mms_id_01_unknown_name_is_a_wrong_configuration() {
        let schedules = schedules(&[]);
        assert_eq!(schedules.get_module_schedule_id("Test"), Err(ReturnCode::InvalidConfig));
    }

    #[test]
    fn mms_set_01_partition_without_permission_is_refused() {
        let schedules = schedules(&[1]);
        assert_eq!(schedules.set_module_schedule(ScheduleId(1)), Err(ReturnCode::InvalidConfig));
        grant(&schedules, 1, 1, 7);
        assert_eq!(schedules.set_module_schedule(ScheduleId(0)), Ok(()));
        assert_eq!(schedules.time.page().schedule_requested(), (1, 0));
    }

    #[test]
    fn mms_set_02_unknown_schedule_is_a_wrong_parameter() {
        let schedules = schedules(&[0]);
        assert_eq!(schedules.set_module_schedule(ScheduleId(3)), Err(ReturnCode::InvalidParam));
        assert_eq!(schedules.time.page().schedule_requested().0, 0);
    }

    #[test]
    fn mms_set_03_current_schedule_is_no_action_where_none_is_pending() {
        let schedules = schedules(&[0]);
        assert_eq!(schedules.set_module_schedule(ScheduleId(0)), Err(ReturnCode::NoAction));
        assert_eq!(schedules.time.page().schedule_requested().0, 0, "nothing is asked for");
    }

    #[test]
    fn mms_set_04_current_schedule_calls_off_one_that_is_pending() {
        let schedules = schedules(&[0]);
        assert_eq!(schedules.set_module_schedule(ScheduleId(2)), Ok(()));
        assert_eq!(schedules.set_module_schedule(ScheduleId(0)), Ok(()));
        assert_eq!(schedules.set_module_schedule(ScheduleId(0)), Err(ReturnCode::NoAction));
        // Somebody else's request, which was pending when the window was granted.
        grant(&schedules, 0, 1, 0);
        assert_eq!(schedules.set_module_schedule(ScheduleId(0)), Ok(()));
    }

    #[test]
    fn mms_set_05_pending_schedule_may_be_asked_for_again() {
        let schedules = schedules(&[0]);
        for times in 1..4 {
            assert_eq!(schedules.set_module_schedule(ScheduleId(2)), Ok(()));
            assert_eq!(schedules.time.page().schedule_requested(), (times, 2));
        }
    }

    #[test]
    fn mms_set_06_last_of_several_requests_is_the_one_that_the_executive_finds() {
        let schedules = schedules(&[0]);
        for schedule in [1, 2, 1] {
            assert_eq!(schedules.set_module_schedule(ScheduleId(schedule)), Ok(()));
            assert_eq!(schedules.get_module_schedule_status().next, ScheduleId(schedule));
        }
        assert_eq!(schedules.time.page().schedule_requested(), (3, 1));
    }

    #[test]
    fn mms_stat_01_status_is_given_to_a_partition_without_any_permission() {
        let schedules = schedules(&[]);
        grant(&schedules, 1, 2, 30);
        let status = schedules.get_module_schedule_status();
        assert_eq!(
            (status.time_of_last_switch_ns, status.current, status.next),
            (30, ScheduleId(1), ScheduleId(2))
        );
    }

    #[test]
    fn mms_stat_02_status_has_the_last_switch_the_current_and_the_next_schedule() {
        let schedules = schedules(&[0, 1, 2]);
        let status = |time_of_last_switch_ns, current, next| ScheduleStatus {
            time_of_last_switch_ns,
            current: ScheduleId(current),
            next: ScheduleId(next),
        };
        assert_eq!(schedules.get_module_schedule_status(), status(0, 0, 0));
        schedules.set_module_schedule(ScheduleId(1)).unwrap();
        schedules.set_module_schedule(ScheduleId(2)).unwrap();
        assert_eq!(schedules.get_module_schedule_status(), status(0, 0, 2));
        grant(&schedules, 0, 2, 0);
        assert_eq!(schedules.get_module_schedule_status(), status(0, 0, 2));
        grant(&schedules, 2, 2, 40);
        assert_eq!(schedules.get_module_schedule_status(), status(40, 2, 2));
    }
}
