//! A page in a browser that a test looks at while it lives, and acts upon: Chromium, spoken to by its DevTools protocol over a pipe.

use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use tempfile::TempDir;

use crate::Browser;

/// A browser starts in a second or two; a busy machine takes longer.
const PATIENCE: Duration = Duration::from_secs(60);

/// See the module's head; the browser ends with it.
#[derive(Debug)]
pub struct Page {
    browser: Child,
    input: ChildStdin,
    output: Receiver<Value>,
    number: u64,
    session: String,
    /// What the page, or the browser about it, said on the console.
    pub console: Vec<String>,
    _profile: TempDir,
}

impl Page {
    /// Opens an empty page.
    pub fn open(browser: &Browser) -> Self {
        let profile = tempfile::Builder::new().prefix("bateleur-browser-").tempdir().unwrap();
        // The protocol's descriptors are 3 and 4.
        let mut browser = Command::new("sh")
            .args(["-c", "exec \"$0\" \"$@\" 3<&0 4>&1 </dev/null >/dev/null 2>&1"])
            .arg(browser.path())
            .args([
                "--headless",
                "--no-sandbox",
                "--disable-gpu",
                "--disable-dev-shm-usage",
                "--remote-debugging-pipe",
            ])
            .arg(format!("--user-data-dir={}", profile.path().display()))
            .arg("about:blank")
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let (input, said) = (browser.stdin.take().unwrap(), browser.stdout.take().unwrap());
        let (send, output) = channel();
        std::thread::spawn(move || {
            let mut said = BufReader::new(said);
            let mut bytes = Vec::new();
            while said.read_until(0, &mut bytes).is_ok_and(|count| count > 0) {
                bytes.pop();
                let _ = send.send(serde_json::from_slice(&bytes).unwrap_or_default()); // the test is over
                bytes.clear();
            }
        });
        let mut page = Self {
            browser,
            input,
            output,
            number: 0,
            session: String::new(),
            console: Vec::new(),
            _profile: profile,
        };
        let target = page.call("Target.createTarget", json!({ "url": "about:blank" }));
        let attach = json!({ "targetId": target["targetId"], "flatten": true });
        page.session = page.call("Target.attachToTarget", attach)["sessionId"].as_str().unwrap().to_owned();
        for domain in ["Page.enable", "Runtime.enable", "Log.enable", "Network.enable"] {
            page.call(domain, json!({}));
        }
        page
    }

    /// Asks the browser something and waits for its answer.
    #[track_caller]
    pub fn call(&mut self, method: &str, parameters: Value) -> Value {
        self.number += 1;
        let mut request = json!({ "id": self.number, "method": method, "params": parameters });
        if !self.session.is_empty() {
            request["sessionId"] = self.session.as_str().into();
        }
        self.input.write_all(format!("{request}\0").as_bytes()).unwrap();
        let begun = Instant::now();
        loop {
            let left = PATIENCE.saturating_sub(begun.elapsed());
            let said = self.output.recv_timeout(left).unwrap_or_else(|_| panic!("no answer to {method}"));
            if said["id"] == self.number {
                assert_eq!(said["error"], Value::Null, "{method}");
                return said["result"].clone();
            }
            self.note(&said);
        }
    }

    fn note(&mut self, said: &Value) {
        let text = match said["method"].as_str() {
            Some("Runtime.consoleAPICalled") => said["params"]["args"].to_string(),
            Some("Runtime.exceptionThrown") => said["params"]["exceptionDetails"].to_string(),
            Some("Log.entryAdded") => said["params"]["entry"].to_string(),
            _ => return,
        };
        self.console.push(text);
    }

    /// Goes to an address.
    #[track_caller]
    pub fn go(&mut self, address: &str) {
        let gone = self.call("Page.navigate", json!({ "url": address }));
        assert_eq!(gone["errorText"], Value::Null, "{address}");
        self.await_true("document.readyState == 'complete'");
    }

    /// The value of an expression in the page.
    #[track_caller]
    pub fn value(&mut self, expression: &str) -> Value {
        let asked = json!({ "expression": expression, "returnByValue": true, "awaitPromise": true });
        let said = self.call("Runtime.evaluate", asked);
        assert_eq!(said["exceptionDetails"], Value::Null, "{expression}");
        said["result"]["value"].clone()
    }

    /// Waits until an expression is true.
    #[track_caller]
    pub fn await_true(&mut self, expression: &str) {
        let begun = Instant::now();
        while self.value(expression) != Value::Bool(true) {
            if begun.elapsed() > PATIENCE {
                let text = self.value("document.body.innerText");
                panic!("never true: {expression}\n{}", text.as_str().unwrap_or_default());
            }
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    /// Acts with the mouse: `mousePressed`, `mouseMoved`, `mouseReleased` at a place on the screen, px.
    pub fn mouse(&mut self, act: &str, [x, y]: [f64; 2]) {
        let button = if act == "mouseMoved" { "none" } else { "left" };
        let event = json!({ "type": act, "x": x, "y": y, "button": button, "clickCount": 1 });
        self.call("Input.dispatchMouseEvent", event);
    }

    /// Presses a key and lets it go.
    pub fn key(&mut self, key: &str) {
        for act in ["keyDown", "keyUp"] {
            self.call("Input.dispatchKeyEvent", json!({ "type": act, "key": key }));
        }
    }

    /// Shows the page on a screen of that width, px, by day or by night.
    pub fn show_on(&mut self, width: u32, height: u32, dark: bool) {
        let screen =
            json!({ "width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600 });
        self.call("Emulation.setDeviceMetricsOverride", screen);
        let scheme = if dark { "dark" } else { "light" };
        let media = json!({ "features": [{ "name": "prefers-color-scheme", "value": scheme }] });
        self.call("Emulation.setEmulatedMedia", media);
    }

    /// Keeps what is seen, the whole page, as a picture.
    pub fn picture(&mut self, path: &Path) {
        let shot = self.call("Page.captureScreenshot", json!({ "captureBeyondViewport": true }));
        std::fs::write(path, from_base64(shot["data"].as_str().unwrap())).unwrap();
    }
}

impl Drop for Page {
    fn drop(&mut self) {
        let _ = self.browser.kill();
        let _ = self.browser.wait();
    }
}

/// What the browser sends as letters.
fn from_base64(text: &str) -> Vec<u8> {
    let six = |letter: u8| match letter {
        b'A'..=b'Z' => letter - b'A',
        b'a'..=b'z' => letter - b'a' + 26,
        b'0'..=b'9' => letter - b'0' + 52,
        b'+' => 62,
        _ => 63,
    };
    let letters: Vec<u8> = text.bytes().filter(|letter| *letter != b'=').map(six).collect();
    let four = |four: &[u8]| {
        let bits =
            four.iter().enumerate().fold(0_u32, |bits, (at, six)| bits | u32::from(*six) << (18 - 6 * at));
        let [_, bytes @ ..] = bits.to_be_bytes();
        bytes[..four.len() - 1].to_vec()
    };
    letters.chunks(4).flat_map(four).collect()
}
