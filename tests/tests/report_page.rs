//! The page of a flight as a reader sees it: in a browser.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use bateleur_tests::{Browser, Ended, among_others, bateleur, flight_schedule};
use serde_json::Value;

/// What the thesis shows of its flights, by the titles of the page.
const PLOTS: [&str; 31] = [
    "Track over ground",
    "Altitude above the runway",
    "Altitude error",
    "Cross-track error, right positive",
    "Partitions over the flight",
    "Airspeed",
    "Bank",
    "Horizontal acceleration",
    "Next way-point",
    "Throttle",
    "Elevator",
    "Aileron",
    "Rudder",
    "North position",
    "East position",
    "North velocity",
    "East velocity",
    "Roll angle",
    "Pitch angle",
    "Yaw angle",
    "Latitude of the fixes",
    "Longitude of the fixes",
    "North velocity of the receiver",
    "East velocity of the receiver",
    "Gyroscope x, roll rate",
    "Gyroscope y, pitch rate",
    "Gyroscope z, yaw rate",
    "Accelerometer",
    "Airspeed by the pitot tube",
    "Height by the static pressure, above where it was zeroed",
    "Execution time of the flight chain",
];

fn fly(choices: &[&str]) -> Ended {
    let schedule = flight_schedule();
    let mut arguments = vec!["fly", "--fast", "--format", "json", "--schedule", schedule.to_str().unwrap()];
    arguments.extend(choices);
    bateleur(&arguments).end()
}

#[test]
fn page_of_a_flight_shows_every_plot_in_a_browser_and_its_console_is_silent() {
    let Some(browser) = Browser::find() else { return };
    let _turn = among_others();
    let flown =
        fly(&["--seed", "5", "--wind", "4", "--turbulence", "light", "--kill", "imu@60"]).expect_code(0);
    for width in [1280, 600] {
        let seen = browser.open(&flown.folder().join("report.html"), width);
        assert_eq!(seen.console, Vec::<String>::new());
        for title in PLOTS {
            let figure = seen.figure(title);
            let number = |name: &str| figure[name].as_f64().unwrap();
            assert!(number("width") > 200.0 && number("height") > 80.0, "{width}: {figure}");
            assert!(number("drawn") >= 1.0 && number("coloured") == number("drawn"), "{width}: {figure}");
            assert_eq!(number("outside"), 0.0, "{width}: {figure}");
        }
        let over = |figure: &&Value| figure["drawn"] == 0;
        assert_eq!(seen.figures().iter().filter(over).count(), 0, "{:?}", seen.measured);
        let (page, screen) = (&seen.measured["width"], &seen.measured["shown"]);
        assert!(page.as_f64() <= screen.as_f64(), "{page} px wide on a screen of {screen}");
    }
}

#[test]
fn page_of_a_failed_flight_is_laid_out_as_well() {
    let Some(browser) = Browser::find() else { return };
    let _turn = among_others();
    let failed = fly(&["--fault", "pitot_blocked@0", "--fault", "gps_lost@0", "--stop", "controller@40"]);
    let page = failed.folder().join("report.html");
    let seen = browser.open(&page, 1280);
    assert_eq!(seen.console, Vec::<String>::new());
    assert!(std::fs::read_to_string(page).unwrap().contains("not completed"));
    assert!(seen.figure("Track over ground")["height"].as_f64().unwrap() > 80.0);
}

#[test]
fn browser_of_the_tests_notices_what_a_page_complains_of() {
    let Some(browser) = Browser::find() else { return };
    let folder = tempfile::tempdir().unwrap();
    let page = folder.path().join("page.html");
    let body = "<script>console.error('it is broken'); undefined.x</script>\
                <figure><svg aria-label='a' viewBox='0 0 10 10' width='300' height='200'></svg></figure>";
    std::fs::write(&page, format!("<!DOCTYPE html><html><body>{body}</body></html>")).unwrap();
    let seen = browser.open(&page, 800);
    assert!(seen.console.iter().any(|line| line.contains("it is broken")), "{:?}", seen.console);
    assert_eq!((seen.console.len(), &seen.figure("a")["drawn"]), (2, &0.into()));
}
