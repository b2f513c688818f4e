//! Headless Chromium for tests of pages, by the [Chrome DevTools protocol](https://chromedevtools.github.io/devtools-protocol/)
//! over pipes: no port is opened, and a test waits for what the page does instead of a time.

#![expect(clippy::unwrap_used, clippy::expect_used, reason = "a tool of tests")]

use serde_json::{Value, json};
use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::thread::spawn;
use std::time::Duration;

/// Longest wait for an answer. A machine that does much else can take long to start a browser.
const ANSWER_S: u64 = 60;

const BROWSERS: [&str; 4] = ["chromium", "chromium-browser", "google-chrome", "google-chrome-stable"];

/// A browser with one page. It ends when this is dropped.
#[derive(Debug)]
pub struct Browser {
    process: Child,
    requests: ChildStdin,
    messages: Receiver<Value>,
    last_id: u64,
    session: Value,
    complaints: Vec<String>,
}

impl Browser {
    /// Starts the first of the known browsers that is installed. `profile` is a folder that only this browser uses.
    ///
    /// # Panics
    /// Without a browser, or when it does not answer.
    #[must_use]
    pub fn start(profile: &Path, width_px: u32, height_px: u32) -> Self {
        let works = |name: &&&str| {
            Command::new(name).arg("--version").output().is_ok_and(|output| output.status.success())
        };
        let name = BROWSERS.iter().find(works);
        let name = name.unwrap_or_else(|| panic!("none of {BROWSERS:?} is installed"));
        // The browser reads requests from its descriptor 3, and writes answers to descriptor 4.
        let mut process = Command::new("sh")
            .args(["-c", "exec \"$0\" \"$@\" 3<&0 4>&1 </dev/null >/dev/null 2>&1", name])
            .args(["--headless", "--remote-debugging-pipe", "--no-sandbox", "--no-first-run"])
            .args(["--disable-background-networking", "--disable-component-update", "--disable-sync"])
            .args(["--use-angle=swiftshader", "--enable-unsafe-swiftshader"])
            .arg(format!("--user-data-dir={}", profile.display()))
            .arg(format!("--window-size={width_px},{height_px}"))
            .arg("about:blank")
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .expect("a shell");
        let requests = process.stdin.take().unwrap();
        let answers = BufReader::new(process.stdout.take().unwrap());
        let (sender, messages) = channel();
        spawn(move || {
            for message in answers.split(0) {
                let message = message.ok().and_then(|text| serde_json::from_slice(&text).ok());
                if message.is_none_or(|message| sender.send(message).is_err()) {
                    return;
                }
            }
        });
        let session = Value::Null;
        let mut browser = Self { process, requests, messages, last_id: 0, session, complaints: Vec::new() };
        let target = browser.call("Target.createTarget", &json!({ "url": "about:blank" }));
        let attach = json!({ "targetId": target["targetId"], "flatten": true });
        browser.session = browser.call("Target.attachToTarget", &attach)["sessionId"].take();
        for domain in ["Page", "Runtime", "Log"] {
            browser.call(&format!("{domain}.enable"), &json!({}));
        }
        browser
    }

    /// Calls a method of the protocol, and returns its result.
    ///
    /// # Panics
    /// When the browser reports an error, or does not answer.
    pub fn call(&mut self, method: &str, params: &Value) -> Value {
        self.last_id += 1;
        let mut request = json!({ "id": self.last_id, "method": method, "params": params });
        if !self.session.is_null() {
            request["sessionId"] = self.session.clone();
        }
        self.requests.write_all(format!("{request}\0").as_bytes()).expect("the browser runs");
        loop {
            let mut message = self.message(method);
            if message["id"] == self.last_id {
                assert!(message["error"].is_null(), "{method}: {}", message["error"]);
                return message["result"].take();
            }
        }
    }

    /// Opens a page, and returns when all that it loads is there.
    ///
    /// # Panics
    /// When the address cannot be opened.
    pub fn open(&mut self, url: &str) {
        let opened = self.call("Page.navigate", &json!({ "url": url }));
        assert!(opened["errorText"].is_null(), "{url}: {}", opened["errorText"]);
        self.evaluate("new Promise(done => document.readyState === 'complete' ? done() : addEventListener('load', done))");
    }

    /// Returns the value of a JavaScript expression in the page. The value of a promise is awaited.
    ///
    /// # Panics
    /// When the expression throws.
    pub fn evaluate(&mut self, expression: &str) -> Value {
        let params = json!({ "expression": expression, "awaitPromise": true, "returnByValue": true });
        let mut answer = self.call("Runtime.evaluate", &params);
        let exception = &answer["exceptionDetails"];
        assert!(exception.is_null(), "{expression}: {exception}");
        answer["result"]["value"].take()
    }

    /// Returns errors, warnings and messages that the page wrote to the console since the last call.
    pub fn complaints(&mut self) -> Vec<String> {
        // An answer comes behind the events before it.
        self.call("Runtime.evaluate", &json!({ "expression": "0" }));
        std::mem::take(&mut self.complaints)
    }

    fn message(&mut self, waiting_for: &str) -> Value {
        let message = self.messages.recv_timeout(Duration::from_secs(ANSWER_S));
        let message = message.unwrap_or_else(|e| panic!("no answer to {waiting_for}: {e}"));
        match message["method"].as_str() {
            Some("Runtime.consoleAPICalled") => self.complaints.push(message["params"]["args"].to_string()),
            Some("Runtime.exceptionThrown") => {
                self.complaints.push(message["params"]["exceptionDetails"].to_string());
            }
            Some("Log.entryAdded") => self.complaints.push(message["params"]["entry"].to_string()),
            _ => {}
        }
        message
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        // Its profile is deleted afterwards. A browser that has ended already needs nothing.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}
