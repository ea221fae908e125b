//! The page of a flight as a reader sees it: in a browser.

use std::path::Path;

use bateleur_tests::{Browser, Ended, Page, among_others, bateleur, flight_schedule};
use serde_json::{Value, json};

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

/// A place in the plot of a chart, as parts of its picture, on the screen.
fn place(page: &mut Page, title: &str, [right, down]: [f64; 2]) -> [f64; 2] {
    let chart = chart(title);
    page.value(&format!("{chart}.scrollIntoView({{ block: 'center' }})"));
    let of = |side: &str, length: &str, part: f64| {
        format!("(box => box.{side} + {part} * box.{length})({chart}.getBoundingClientRect())")
    };
    [of("left", "width", right), of("top", "height", down)].map(|what| page.value(&what).as_f64().unwrap())
}

fn chart(title: &str) -> String {
    format!("document.querySelector('svg[aria-label=\"{title}\"]')")
}

/// What is written beside the cursor of a chart; nothing where it has none.
fn readout(page: &mut Page, title: &str) -> String {
    let text = format!("{}.nextElementSibling.innerText.replace(/\\s+/g, ' ')", chart(title));
    page.value(&text).as_str().unwrap().trim().to_owned()
}

/// The numbers along the axis of a chart.
fn along(page: &mut Page, title: &str) -> Vec<f64> {
    let texts = format!(
        "[...{}.querySelectorAll('.across text')].map(text => Number(text.textContent))",
        chart(title)
    );
    page.value(&texts).as_array().unwrap().iter().map(|number| number.as_f64().unwrap()).collect()
}

/// Keeps a picture where the environment asks for pictures.
fn keep(page: &mut Page, name: &str) {
    if let Some(folder) = std::env::var_os("BATELEUR_PICTURES") {
        page.picture(&Path::new(&folder).join(name));
    }
}

fn open(browser: &Browser, file: &Path) -> Page {
    let mut page = Page::open(browser);
    page.show_on(1200, 1000, false);
    page.go(&format!("file://{}", file.display()));
    page
}

#[test]
fn charts_show_values_at_the_pointer_and_zoom_together() {
    let Some(browser) = Browser::find() else { return };
    let _turn = among_others();
    let flown = fly(&["--seed", "5", "--kill", "imu@60"]).expect_code(0);
    let mut page = open(&browser, &flown.folder().join("report.html"));
    let whole = along(&mut page, "Airspeed");

    let [from, to] = [0.4, 0.5].map(|right| place(&mut page, "Airspeed", [right, 0.5]));
    page.mouse("mouseMoved", from);
    page.await_true(&format!("!{}.nextElementSibling.hidden", chart("Airspeed")));
    // The mission asks for 22 m/s, and for 160 m: what the charts show is what was flown.
    let airspeed = readout(&mut page, "Airspeed");
    assert!(airspeed.contains(" asked for 22.00 m/s truth 2"), "{airspeed}");
    let altitude = readout(&mut page, "Altitude above the runway");
    assert!(altitude.contains(" asked for 160.0 m "), "every chart shows its values: {altitude}");

    page.mouse("mousePressed", from);
    page.mouse("mouseMoved", to);
    page.mouse("mouseReleased", to);
    let zoomed = along(&mut page, "Airspeed");
    let [first, last] = [zoomed[0], *zoomed.last().unwrap()];
    assert!(last - first < 0.15 * whole.last().unwrap(), "{zoomed:?}");
    for other in ["Altitude error", "Elevator", "Gyroscope x, roll rate", "Partitions over the flight"] {
        let along = along(&mut page, other);
        let near = |number: &f64| (first - 5.0..=last + 5.0).contains(number);
        assert!(!along.is_empty() && along.iter().all(near), "{other}: {along:?}");
    }
    keep(&mut page, "report-zoomed.png");
    let lane = place(&mut page, "Partitions over the flight", [0.5, 0.5]);
    page.mouse("mousePressed", lane);
    page.mouse("mouseReleased", lane);
    assert_eq!(along(&mut page, "Airspeed"), zoomed, "a click selects nothing");
    page.value("document.querySelector('.bar button').click()");
    assert_eq!(along(&mut page, "Airspeed"), whole, "all is shown again as it was drawn");
    assert_eq!(page.console, Vec::<String>::new());
}

#[test]
fn charts_are_read_with_the_keys() {
    let Some(browser) = Browser::find() else { return };
    let _turn = among_others();
    let flown = fly(&["--seed", "5"]).expect_code(0);
    let mut page = open(&browser, &flown.folder().join("report.html"));
    let whole = along(&mut page, "Bank");
    page.value(&format!("{}.focus()", chart("Bank")));
    page.key("ArrowRight");
    page.await_true("document.querySelector('.spoken').textContent.includes('truth')");
    let said = |page: &mut Page| {
        page.value("document.querySelector('.spoken').textContent").as_str().unwrap().to_owned()
    };
    let first = said(&mut page);
    assert!(first.starts_with("at 1") && first.ends_with(" °"), "{first}");
    page.key("ArrowRight");
    let second = said(&mut page);
    assert_ne!(first, second);
    page.key("+");
    page.key("+");
    let zoomed = along(&mut page, "Elevator");
    assert!(zoomed.last().unwrap() - zoomed[0] < 0.3 * whole.last().unwrap(), "{zoomed:?}");
    assert_eq!(said(&mut page), second, "the cursor stays where it was");
    page.key("Escape");
    assert_eq!((along(&mut page, "Bank"), said(&mut page)), (whole, String::new()));
    assert_eq!(page.console, Vec::<String>::new());
}

#[test]
fn finger_selects_a_span_on_a_phone_and_nothing_is_loaded() {
    let Some(browser) = Browser::find() else { return };
    let _turn = among_others();
    let flown = fly(&["--seed", "5"]).expect_code(0);
    let mut page = open(&browser, &flown.folder().join("report.html"));
    page.show_on(390, 844, true);
    page.call("Emulation.setTouchEmulationEnabled", json!({ "enabled": true }));
    let whole = along(&mut page, "Elevator");
    for (act, right) in [("touchStart", 0.4), ("touchMove", 0.5), ("touchMove", 0.6)] {
        let [x, y] = place(&mut page, "Altitude error", [right, 0.5]);
        let touch = json!({ "type": act, "touchPoints": [{ "x": x, "y": y }] });
        page.call("Input.dispatchTouchEvent", touch);
    }
    page.call("Input.dispatchTouchEvent", json!({ "type": "touchEnd", "touchPoints": [] }));
    page.await_true("!document.querySelector('.bar').hidden");
    let zoomed = along(&mut page, "Elevator");
    assert!(zoomed.last().unwrap() - zoomed[0] < 0.5 * whole.last().unwrap(), "{zoomed:?}");
    keep(&mut page, "report-phone.png");
    let widths = ["document.documentElement.scrollWidth", "innerWidth"].map(|width| page.value(width));
    assert_eq!(widths, [390, 390].map(Value::from));
    assert_eq!(page.value("performance.getEntriesByType('resource').length"), 0);
    assert_eq!(page.console, Vec::<String>::new());
}

#[test]
fn two_flights_are_compared_on_one_page() {
    let Some(browser) = Browser::find() else { return };
    let _turn = among_others();
    let flown = [&["--seed", "5", "--kill", "imu@60"][..], &["--seed", "6", "--wind", "5"]];
    let flown = flown.map(|choices| fly(choices).expect_code(0));
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("both.html");
    let [a, b] = flown.each_ref().map(|flown| flown.folder());
    let [a, b, html] = [&a, &b, &file].map(|path| path.to_str().unwrap());
    let compared = bateleur(&["compare", a, b, "--html", html]).end().expect_code(1);
    assert!(compared.stderr.contains("page: "), "{}", compared.stderr);
    let mut page = open(&browser, &file);
    for title in ["Tracks over ground", "Altitude error", "Airspeed", "Pitch angle", "Elevator"] {
        let curves = format!(
            "[...{}.querySelectorAll('.curves path')].map(path => path.dataset.name).join()",
            chart(title)
        );
        let curves = page.value(&curves);
        assert!(curves.as_str().unwrap().ends_with("A,B"), "{title}: {curves}");
    }
    let at = place(&mut page, "Altitude error", [0.6, 0.5]);
    page.mouse("mouseMoved", at);
    page.await_true(&format!("!{}.nextElementSibling.hidden", chart("Airspeed")));
    let airspeed = readout(&mut page, "Airspeed");
    assert!(airspeed.contains(" A 2") && airspeed.contains(" B 2"), "{airspeed}");
    let rows = page.value("[...document.querySelectorAll('tr')].map(row => row.innerText).join('\\n')");
    let rows = rows.as_str().unwrap();
    assert!(rows.contains("restarts\t1\t0\t−1") && rows.contains("A\t60.00\timu\tkilled"), "{rows}");
    keep(&mut page, "compared.png");
    assert_eq!(page.console, Vec::<String>::new());
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
