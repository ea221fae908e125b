//! `bateleur view` and `bateleur metrics` as a user sees them: in a browser, by a scraper's parser, and by whoever is not meant to see them.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::time::Duration;

use bateleur_recording::PORTS_FILE;
use bateleur_tests::{
    Browser, Page, Peer, Sketch, Started, alone, await_some, bateleur, flight_schedule,
    laps_of_small_mission, quantile,
};
use rustix::process::Signal;
use serde_json::Value;

/// Starts a view and gives its address.
fn view(arguments: &[&str]) -> (Started, String) {
    let mut view = bateleur(&[&["view"], arguments].concat());
    view.await_words("view: http");
    let said = view.said();
    let address = said.lines().find_map(|line| line.strip_prefix("view: ")).unwrap().to_owned();
    (view, address)
}

/// Two partitions that behave, on the wall clock. The folder must live as long.
fn module() -> (Started, tempfile::TempDir) {
    let folder = tempfile::tempdir().unwrap();
    let keys = "restart = { start = \"cold\", budget = 50, within = \"10s\", then = \"idle\" }";
    let schedule =
        Sketch::new().partition("one", "counter", 1000, keys).partition("two", "counter", 1000, keys);
    let schedule = schedule.write(folder.path());
    let mut module = bateleur(&["run", "--schedule", &schedule]);
    module.await_words("2 partitions are ready");
    (module, folder)
}

/// Keeps a picture where the environment asks for pictures.
fn keep(page: &mut Page, name: &str) {
    if let Some(folder) = std::env::var_os("BATELEUR_PICTURES") {
        page.picture(&Path::new(&folder).join(name));
    }
}

#[track_caller]
fn expect_as_wide_as_the_screen(page: &mut Page) {
    let [width, screen] = ["document.documentElement.scrollWidth", "innerWidth"].map(|what| page.value(what));
    assert!(width.as_f64() <= screen.as_f64(), "{width} px wide on a screen of {screen}");
}

/// Starts what a scraper reads from and gives its address.
fn metrics() -> (Started, String) {
    let mut served = bateleur(&["metrics", "--listen", "127.0.0.1:0"]);
    served.await_words("metrics: http");
    let said = served.said();
    let address = said.split("http://").nth(1).unwrap().split('/').next().unwrap().to_owned();
    (served, address)
}

/// Head and body of what a scraper is told.
fn scrape(address: &str, accept: &str) -> (String, String) {
    let asked = format!("GET /metrics HTTP/1.1\r\nHost: {address}\r\nAccept: {accept}\r\n\r\n");
    let mut stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(30))).unwrap();
    stream.write_all(asked.as_bytes()).unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    let (head, body) = answer.split_once("\r\n\r\n").unwrap();
    (head.to_owned(), body.to_owned())
}

/// Module time, ns.
fn module_ns(module: &str) -> u64 {
    let status = bateleur(&["ps", "--format", "json", "--module", module]).end().expect_code(0).summary();
    status["modules"][0]["module_ns"].as_u64().unwrap()
}

/// What a server says to a request.
fn say(address: &str, request: &str) -> String {
    let mut stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    stream.write_all(request.as_bytes()).unwrap();
    let mut bytes = vec![0; 4096];
    let count = stream.read(&mut bytes).unwrap();
    String::from_utf8_lossy(&bytes[..count]).into_owned()
}

/// A tool that `tests/prometheus/prepare` fetches. `None`: it is not there, and that has been said. In CI that is a failure.
fn promtool() -> Option<std::path::PathBuf> {
    let path = bateleur_tests::repository().join("target/prometheus/usr/bin/promtool");
    if !path.is_file() {
        let needed = std::env::var_os("CI").is_some_and(|value| value == "true");
        assert!(!needed, "promtool is needed in CI: tests/prometheus/prepare fetches it");
        eprintln!("NOT TESTED with promtool: there is none (on Debian: tests/prometheus/prepare)");
    }
    path.is_file().then_some(path)
}

/// What a command says of what is written into it.
#[track_caller]
fn told(command: &mut std::process::Command, text: &str) -> String {
    use std::process::Stdio;
    let (input, output) = (Stdio::piped(), Stdio::piped());
    let mut child = command.stdin(input).stdout(output).stderr(Stdio::piped()).spawn().unwrap();
    child.stdin.take().unwrap().write_all(text.as_bytes()).unwrap();
    let ended = child.wait_with_output().unwrap();
    let said = [ended.stdout, ended.stderr].concat();
    let said = String::from_utf8_lossy(&said).into_owned();
    assert!(ended.status.success(), "{said}\n{text}");
    said
}

/// What shares the machine with no other test.
mod alone {
    use super::*;

    #[test]
    fn partition_that_a_button_kills_is_seen_to_come_back_and_a_frozen_one_to_stand_still() {
        let Some(browser) = Browser::find() else { return };
        let _turn = alone();
        let (module, _folder) = module();
        let (_view, address) = view(&["--module", &module.pid().to_string()]);
        let mut page = Page::open(&browser);
        page.go(&address);
        let row = |cell| {
            format!("document.querySelector('tr[data-partition=two] td:nth-child({cell})').textContent")
        };
        page.await_true(
            "!!document.querySelector('tr[data-partition=two]') && !!document.querySelector('#frame svg')",
        );
        page.value("document.getElementById('partition').value = 'two'");
        page.value("document.querySelector('[data-ask=kill]').click()");
        page.await_true("document.getElementById('answer').textContent.includes('two is killed')");
        page.await_true(&format!("{} == '1' && {} == 'normal'", row(3), row(2)));
        page.await_true("document.getElementById('health').textContent.includes('two: killed')");
        page.value("document.querySelector('[data-ask=freeze]').click()");
        page.await_true(&format!("{} == 'frozen'", row(2)));
        page.value("document.querySelector('[data-ask=thaw]').click()");
        page.await_true(&format!("{} == 'normal'", row(2)));
        page.value("document.getElementById('target').value = 'nobody'; document.getElementById('fault').value = 'panic'");
        page.value("document.querySelector('#inject button').click()");
        page.await_true("document.getElementById('answer').textContent.includes('nobody')");
        assert_eq!(
            page.value("document.getElementById('air').hidden"),
            true,
            "a module that does not fly has no map"
        );
        assert_eq!(page.console, Vec::<String>::new());
        module.signal(Signal::TERM);
        page.await_true("document.getElementById('note').textContent.includes('last that was heard')");
        module.end().expect_code(0);
    }

    #[test]
    fn who_lacks_the_token_or_comes_from_another_page_sees_nothing_and_orders_nothing() {
        let _turn = alone();
        let (module, _folder) = module();
        let (_view, url) = view(&["--module", &module.pid().to_string()]);
        let (address, token) = url.strip_prefix("http://").unwrap().split_once("/?token=").unwrap();
        assert!(address.starts_with("127.0.0.1:"), "{address}");
        let order = "{\"ask\":\"kill\",\"partition\":\"one\"}";
        let kill = |host: &str, more: &str, token: &str| {
            let length = order.len();
            format!(
                "POST /order?token={token} HTTP/1.1\r\nHost: {host}\r\n{more}Content-Length: {length}\r\n\r\n{order}"
            )
        };
        let get =
            |path: &str, token: &str| format!("GET {path}?token={token} HTTP/1.1\r\nHost: {address}\r\n\r\n");
        let json = "Content-Type: application/json\r\n";
        for refused in [
            get("/", ""),
            get("/", "0"),
            get("/", &token[1..]),
            get("/events", &token.to_uppercase().replace(|letter: char| letter.is_ascii_digit(), "0")),
            kill(address, json, ""),
            kill("rebound.example", json, token),
            kill(address, &format!("{json}Origin: http://elsewhere.example\r\n"), token),
            kill(address, "Content-Type: text/plain\r\n", token),
        ] {
            let said = say(address, &refused);
            assert!(said.starts_with("HTTP/1.1 40"), "{refused}\n{said}");
        }
        let page = say(address, &get("/", token));
        assert!(
            page.starts_with("HTTP/1.1 200 ") && page.contains("Content-Security-Policy: default-src 'none'"),
            "{page}"
        );
        let pid = module.pid().to_string();
        let status = bateleur(&["ps", "--format", "json", "--module", &pid]).end().expect_code(0).summary();
        assert_eq!(status["modules"][0]["partitions"][0]["generation"], 0, "{status}");
        let done = say(address, &kill(address, json, token));
        assert!(done.contains("200 OK"), "{done}");
    }

    #[test]
    fn page_moves_while_a_flight_flies_and_its_recording_plays_with_the_slider() {
        let Some(browser) = Browser::find() else { return };
        let _turn = alone();
        let schedule = flight_schedule();
        let flight =
            bateleur(&["fly", "--wind", "5", "--wind-from", "250", "--schedule", schedule.to_str().unwrap()]);
        let module = flight.module();
        let (view, address) = view(&["--module", &module]);
        let mut page = Page::open(&browser);
        page.show_on(1280, 900, false);
        page.go(&address);
        page.await_true("!document.getElementById('air').hidden && !!document.querySelector('#map svg')");
        for (id, what) in [
            ("head", "module time"),
            ("numbers", "speeds"),
            ("map", "map"),
            ("frame", "windows"),
            ("plot", "plot"),
        ] {
            let before = page.value(&format!("window.before = document.getElementById('{id}').innerHTML"));
            assert_ne!(before, "", "{what}");
            page.await_true(&format!("document.getElementById('{id}').innerHTML != window.before"));
        }
        page.await_true("Number(document.getElementById('delay').dataset.p95) > 0");
        let delay = page.value("document.getElementById('delay').textContent");
        eprintln!("{delay}");
        if std::env::var_os("BATELEUR_PICTURES").is_some() {
            // A picture of a runway would say little.
            page.await_true(
                "parseFloat(document.querySelector('#numbers div:nth-child(3) b').textContent) > 100",
            );
        }
        for (width, dark, name) in
            [(1280, false, "view.png"), (1280, true, "view-dark.png"), (390, false, "view-phone.png")]
        {
            page.show_on(width, 900, dark);
            std::thread::sleep(Duration::from_millis(300)); // a screen of another width is drawn
            expect_as_wide_as_the_screen(&mut page);
            keep(&mut page, name);
        }
        assert_eq!(page.console, Vec::<String>::new());
        flight.signal(Signal::INT);
        let flown = flight.end().expect_code(1);
        drop(view);
        let (_view, address) = self::view(&[flown.folder().to_str().unwrap()]);
        page.show_on(1280, 900, false);
        page.console.clear(); // the other one is gone
        page.go(&address);
        page.await_true("document.getElementById('state').textContent == 'recorded'");
        let time = |page: &mut Page, share: f64| {
            let set = format!(
                "(s => {{ s.value = Number(s.min) + {share} * (s.max - s.min); s.dispatchEvent(new Event('input')); return s.value }})(document.getElementById('time'))"
            );
            let at = page.value(&set).as_str().unwrap().parse::<f64>().unwrap();
            page.await_true(&format!(
                "Math.abs(parseFloat(document.getElementById('head').textContent) - {at}) < 0.011"
            ));
            page.value("document.getElementById('frame').innerHTML")
        };
        let seen: Vec<Value> = [0.3, 0.6, 0.9].map(|share| time(&mut page, share)).into();
        assert!(seen[0] != seen[1] && seen[1] != seen[2], "the windows are those of the time");
        keep(&mut page, "view-recorded.png");
        // The charts are those of the report: the one that the next moment has drawn shows its values as well.
        page.value("document.querySelector('#plot svg').focus()");
        page.key("End");
        page.await_true("!document.querySelector('#plot .cursor').hidden");
        time(&mut page, 0.902);
        page.await_true("document.querySelector('#plot .readout').textContent.includes(' rad')");
        time(&mut page, 0.2);
        page.value("document.getElementById('play').click(); window.begun = parseFloat(document.getElementById('head').textContent)");
        page.await_true("parseFloat(document.getElementById('head').textContent) > window.begun + 1");
        assert_eq!(page.console, Vec::<String>::new());
    }

    #[test]
    fn figures_of_ten_modules_side_by_side_pass_promtool_in_what_is_printed_and_what_is_served() {
        const MODULES: usize = 10;
        let _turn = alone();
        let modules: Vec<_> = (0..MODULES).map(|_| module()).collect();
        let mut text = String::new();
        let windows = |text: &str, module: &Started| {
            let labels = format!(
                "bateleur_windows_total{{module=\"test\",pid=\"{}\",partition=\"two\"}} ",
                module.pid()
            );
            text.lines().any(|line| line.starts_with(&labels))
        };
        let all = await_some(Duration::from_secs(60), || {
            text = bateleur(&["metrics", "--format", "prometheus"]).end().expect_code(0).stdout;
            modules.iter().all(|(module, _)| windows(&text, module)).then_some(())
        });
        assert!(all.is_some(), "{text}");
        // A scraper reads a name and its labels once.
        let mut series: Vec<&str> = text.lines().filter_map(|line| Some(line.rsplit_once(' ')?.0)).collect();
        series.retain(|line| !line.starts_with('#'));
        let count = series.len();
        series.sort_unstable();
        series.dedup();
        assert_eq!(series.len(), count, "{text}");
        let (_served, address) = metrics();
        let (head, body) = scrape(&address, "text/plain;version=0.0.4;q=1,*/*;q=0.1");
        assert!(head.contains("text/plain; version=0.0.4"), "{head}");
        assert!(modules.iter().all(|(module, _)| windows(&body, module)), "{body}");
        let (head, newer) = scrape(
            &address,
            "application/openmetrics-text;version=1.0.0;q=0.5,text/plain;version=0.0.4;q=0.4",
        );
        assert!(
            head.contains("application/openmetrics-text") && newer.ends_with("# EOF\n"),
            "{head}\n{newer}"
        );
        let Some(promtool) = promtool() else { return };
        for text in [text, body] {
            let said = told(std::process::Command::new(&promtool).args(["check", "metrics"]), &text);
            assert_eq!(said.trim(), "", "promtool finds nothing to say");
        }
    }

    #[test]
    fn figures_of_two_modules_are_told_apart_and_read_by_another_parser() {
        let _turn = alone();
        let modules = [module(), module()];
        let windows = |text: &str, module: &Started| -> Option<u64> {
            let labels = format!("{{module=\"test\",pid=\"{}\",partition=\"two\"}}", module.pid());
            let line = format!("bateleur_windows_total{labels} ");
            text.lines().find_map(|each| each.strip_prefix(&line))?.parse().ok()
        };
        let mut text = String::new();
        let both = await_some(Duration::from_secs(30), || {
            text = bateleur(&["metrics"]).end().expect_code(0).stdout;
            let have = |(module, _): &(Started, _)| windows(&text, module).is_some_and(|count| count > 0);
            modules.iter().all(have).then_some(())
        });
        assert!(both.is_some() && text.ends_with("# EOF\n"), "{text}");
        let Some(python) = bateleur_tests::python() else { return };
        let mut parser = std::process::Command::new(python)
        .args(["-c", "import sys\nfrom prometheus_client.openmetrics.parser import text_string_to_metric_families as read\nfor f in read(sys.stdin.read()): print(f.name, f.type, len(f.samples))"])
        .stdin(std::process::Stdio::piped())
        .stdout(std::process::Stdio::piped())
        .spawn()
        .unwrap();
        parser.stdin.take().unwrap().write_all(text.as_bytes()).unwrap();
        let read = parser.wait_with_output().unwrap();
        let families = String::from_utf8_lossy(&read.stdout);
        assert!(read.status.success(), "the parser refuses:\n{text}");
        for family in [
            "bateleur_windows counter",
            "bateleur_window_lateness_seconds histogram",
            "bateleur_partition_memory_bytes gauge",
        ] {
            assert!(families.contains(family), "{family} is not in\n{families}");
        }
    }

    #[test]
    #[ignore = "flies for ten minutes, and needs the server of Foxglove's protocol"]
    fn flight_of_ten_minutes_is_watched_by_a_browser_a_scraper_and_foxglove_which_misses_nothing() {
        let Some(browser) = Browser::find() else { return };
        let _turn = alone();
        let folder = tempfile::tempdir().unwrap();
        let mission = laps_of_small_mission(folder.path(), 19);
        let schedule = flight_schedule();
        let (schedule, mission) = (schedule.to_str().unwrap(), mission.to_str().unwrap());
        let mut flight = bateleur(&["fly", "--format", "json", "--schedule", schedule, "--mission", mission]);
        let module = flight.module();
        let Some((server, address)) = crate::foxglove::serve(&module) else { return };
        let foxglove = Peer::start("foxglove.py", &[&address]).unwrap();
        let mut page = Page::open(&browser);
        let (mut watched, mut alone, mut delays) = (Vec::new(), Vec::new(), Vec::new());
        let settled = Duration::from_secs(4);
        let minute = |work: &mut dyn FnMut()| {
            std::thread::sleep(settled);
            let begun_ns = module_ns(&module);
            for _ in 0..26 {
                std::thread::sleep(Duration::from_secs(1));
                work();
            }
            begun_ns..module_ns(&module)
        };
        for _ in 0..9 {
            alone.push(minute(&mut || ()));
            let (view, address) = view(&["--module", &module]);
            let (metrics, scraped) = metrics();
            page.go(&address);
            page.await_true("Number(document.getElementById('delay').dataset.p95) > 0");
            watched.push(minute(&mut || {
                scrape(&scraped, "application/openmetrics-text;version=1.0.0");
            }));
            delays.push(page.value("document.getElementById('delay').dataset.p95"));
            page.go("about:blank");
            drop((view, metrics));
            if flight.has_ended() {
                break;
            }
        }
        let heard = foxglove.finish();
        let flown = flight.end_within(Duration::from_secs(300));
        let closing = server.end().expect_code(0);
        let summary = flown.summary();
        assert_eq!(summary["completed"], true, "{}\n{}", summary["failure"], flown.stderr);
        let windows = flown.windows();
        let within = |spans: &[std::ops::Range<u64>]| {
            let of_these = |window: &&bateleur_tests::Window| {
                spans.iter().any(|span| span.contains(&window.planned_start_ns))
            };
            let late: Vec<u64> =
                windows.iter().filter(of_these).filter_map(|window| window.lateness_ns()).collect();
            (late.len(), [0.5, 0.99, 0.999].map(|part| quantile(late.iter().copied(), part)))
        };
        assert!(watched.len() >= 8, "{} half minutes were watched", watched.len());
        eprintln!("late by (p50, p99, p99.9 in ns), watched: {:?}", within(&watched));
        eprintln!("late by (p50, p99, p99.9 in ns), alone: {:?}", within(&alone));
        eprintln!("from a port's write to the screen, p95 in ms: {delays:?}");
        let compared =
            crate::foxglove::assert_nothing_lost(&heard["topics"], &flown.folder().join(PORTS_FILE));
        assert!(compared > 100_000, "{compared} messages were compared");
        eprintln!("{compared} messages to Foxglove, none lost");
        closing.expect_words(&["messages handed on, 0 not seen"]);
    }
}
