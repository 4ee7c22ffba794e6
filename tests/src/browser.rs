//! Chromium without a window, driven through chromedriver by the WebDriver protocol (W3C).

use std::io::{BufRead as _, BufReader, Lines, Read as _, Write as _};
use std::net::TcpStream;
use std::process::{Child, ChildStdout, Command, Stdio};
use std::time::Duration;

use serde_json::{Value, json};

use crate::in_ci;

/// The number of attempts to start chromedriver.
const ATTEMPTS: usize = 20;

/// Starts chromedriver. Returns it with its port and its remaining output. chromedriver chooses a port that
/// is free for IPv6 and takes the same number for IPv4, so it ends if another process has that one.
fn start_driver() -> std::io::Result<(Child, u16, Lines<BufReader<ChildStdout>>)> {
    for _ in 0..ATTEMPTS {
        let mut driver = Command::new("chromedriver")
            .arg("--port=0")
            .stdout(Stdio::piped())
            .spawn()?;
        let mut lines = BufReader::new(driver.stdout.take().unwrap()).lines();
        let port = lines.find_map(|line| {
            let line = line.unwrap();
            let (_, port) = line.rsplit_once("successfully on port ")?;
            port.trim_end_matches('.').parse().ok()
        });
        if let Some(port) = port {
            return Ok((driver, port, lines));
        }
        driver.wait()?;
    }
    Err(std::io::Error::other(format!(
        "it found no free port in {ATTEMPTS} attempts"
    )))
}

/// A separate browser, which ends when it is dropped.
pub struct Browser {
    driver: Child,
    port: u16,
    session: String,
}

impl Browser {
    /// Starts a browser with a window of this size. Returns `None` without chromedriver, which is a failure
    /// on CI.
    pub fn start([width, height]: [u32; 2]) -> Option<Self> {
        let (driver, port, lines) = match start_driver() {
            Ok(started) => started,
            Err(e) if !in_ci() => {
                eprintln!(
                    "not run: chromedriver cannot be started ({e}); scripts/setup.sh --for test"
                );
                return None;
            }
            Err(e) => panic!("chromedriver cannot be started: {e}"),
        };
        // chromedriver continues to write, so its output must be read.
        std::thread::spawn(move || lines.for_each(drop));
        let arguments = [
            "--headless=new".to_owned(),
            "--no-sandbox".to_owned(),
            "--disable-dev-shm-usage".to_owned(),
            // This flag enables WebGL2 without a GPU.
            "--use-angle=swiftshader".to_owned(),
            "--enable-unsafe-swiftshader".to_owned(),
            "--hide-scrollbars".to_owned(),
            format!("--window-size={width},{height}"),
        ];
        let mut browser = Self {
            driver,
            port,
            session: String::new(),
        };
        let wanted = json!({"capabilities": {"alwaysMatch": {
            "goog:chromeOptions": {"args": arguments},
            "goog:loggingPrefs": {"browser": "ALL"},
        }}});
        let made = browser.call("POST", "/session", &wanted);
        browser.session = made["sessionId"].as_str().unwrap().to_owned();
        Some(browser)
    }

    /// Opens an address.
    pub fn open(&self, url: &str) {
        self.session("POST", "/url", &json!({"url": url}));
    }

    /// Runs the body of an asynchronous JavaScript function, and returns its result.
    pub fn run(&self, body: &str) -> Value {
        let body = format!("return (async () => {{ {body} }})()");
        self.session(
            "POST",
            "/execute/sync",
            &json!({"script": body, "args": []}),
        )
    }

    /// Clicks at a point of the window.
    pub fn click(&self, x: i32, y: i32) {
        let actions = json!([
            {"type": "pointerMove", "x": x, "y": y, "duration": 0},
            {"type": "pointerDown", "button": 0},
            {"type": "pointerUp", "button": 0},
        ]);
        self.session(
            "POST",
            "/actions",
            &json!({"actions": [{"type": "pointer", "id": "mouse", "actions": actions}]}),
        );
    }

    /// Returns a picture of the window, as PNG in base64.
    pub fn picture(&self) -> String {
        self.session("GET", "/screenshot", &Value::Null)
            .as_str()
            .unwrap()
            .to_owned()
    }

    /// Returns the messages of the console since the last call.
    pub fn messages(&self) -> Vec<String> {
        let log = self.session("POST", "/se/log", &json!({"type": "browser"}));
        log.as_array()
            .unwrap()
            .iter()
            .map(|entry| entry["message"].as_str().unwrap().to_owned())
            .collect()
    }

    fn session(&self, verb: &str, path: &str, body: &Value) -> Value {
        self.call(verb, &format!("/session/{}{path}", self.session), body)
    }

    /// Sends one request, and returns the value in the answer.
    fn call(&self, verb: &str, path: &str, body: &Value) -> Value {
        let body = if body.is_null() {
            String::new()
        } else {
            body.to_string()
        };
        let mut stream = TcpStream::connect(("127.0.0.1", self.port)).unwrap();
        let length = body.len();
        write!(
            stream,
            "{verb} {path} HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\nContent-Type: \
             application/json\r\nContent-Length: {length}\r\n\r\n{body}"
        )
        .unwrap();
        let mut reader = BufReader::new(stream);
        let mut length = 0;
        for line in reader
            .by_ref()
            .lines()
            .map(Result::unwrap)
            .take_while(|line| !line.is_empty())
        {
            if let Some(value) = line.to_ascii_lowercase().strip_prefix("content-length:") {
                length = value.trim().parse().unwrap();
            }
        }
        let mut answer = vec![0; length];
        reader.read_exact(&mut answer).unwrap();
        let answer: Value = serde_json::from_slice(&answer).unwrap();
        assert!(
            answer["value"]["error"].is_null(),
            "{verb} {path}: {answer}"
        );
        answer["value"].clone()
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        // Without this request, the browser would outlive its driver. This code must not panic, because a
        // test may be failing.
        if let Ok(mut stream) = TcpStream::connect(("127.0.0.1", self.port)) {
            let path = format!("/session/{}", self.session);
            let asked = write!(
                stream,
                "DELETE {path} HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n\r\n"
            );
            if asked.is_ok() {
                // The answer arrives after the browser has ended, but the driver keeps the connection open.
                drop(stream.set_read_timeout(Some(Duration::from_secs(10))));
                drop(stream.read(&mut [0; 16]));
            }
        }
        // The driver has ended, or ends now.
        drop(self.driver.kill());
        drop(self.driver.wait());
    }
}
