//! The page of runs in a real browser, which a driver moves as a person would.

use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use augnerf::settings::Method;
use serde_json::{Value, json};

use crate::view::{ask, served, shown, shown_with};

/// Tries of a condition, and the pause between two.
const TRIES: usize = 300;
const PAUSE: Duration = Duration::from_millis(100);
/// The page shows a sharp picture.
const SHARP: &str = "document.getElementById('status').textContent.includes('shown after')";

/// Chromium without a screen, by WebDriver.
pub struct Browser {
    driver: Child,
    session: String,
}

impl Browser {
    /// Opens a page in a window of some size.
    pub fn open(url: &str, width: u32, height: u32) -> Browser {
        let mut driver = Command::new("chromedriver")
            .arg("--port=0")
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .expect("no chromedriver is installed: this test opens the page by it");
        let said = BufReader::new(driver.stdout.take().unwrap()).lines().map_while(Result::ok);
        let port = said
            .filter_map(|line| Some(line.rsplit_once("successfully on port ")?.1.trim_end_matches('.').to_string()));
        let base = format!("http://127.0.0.1:{}", { port }.next().expect("the driver says its port"));
        let arguments = ["--headless=new", "--no-sandbox", "--disable-gpu", "--disable-extensions"];
        let window = format!("--window-size={width},{height}");
        let arguments: Vec<&str> = arguments.into_iter().chain([window.as_str()]).collect();
        let wanted = json!({ "capabilities": { "alwaysMatch": {
            "goog:chromeOptions": { "args": arguments },
            "goog:loggingPrefs": { "browser": "ALL" },
        } } });
        let reply = ask("POST", &format!("{base}/session"), "", &wanted.to_string()).json();
        let id = reply["value"]["sessionId"].as_str().unwrap_or_else(|| panic!("no session: {reply}"));
        let browser = Browser { driver, session: format!("{base}/session/{id}") };
        browser.call("url", &json!({ "url": url }));
        browser
    }

    fn call(&self, command: &str, body: &Value) -> Value {
        let reply = ask("POST", &format!("{}/{command}", self.session), "", &body.to_string()).json();
        assert!(reply["value"]["error"].is_null(), "{command}: {}", reply["value"]);
        reply["value"].clone()
    }

    /// What a script returns.
    pub fn run(&self, script: &str) -> Value {
        self.call("execute/sync", &json!({ "script": script, "args": [] }))
    }

    /// The value of an expression in the page.
    pub fn value(&self, expression: &str) -> Value {
        self.run(&format!("return {expression}"))
    }

    /// Waits until an expression is true.
    #[track_caller]
    fn until(&self, expression: &str) {
        for _ in 0..TRIES {
            if self.value(expression) == true {
                return;
            }
            std::thread::sleep(PAUSE);
        }
        panic!("never {expression}; status: {}", self.value("document.getElementById('status').textContent"));
    }

    /// Waits for the sharp picture.
    #[track_caller]
    fn sharp(&self) -> String {
        self.until(SHARP);
        self.until("!busy && !wanted");
        self.picture()
    }

    /// Does something, and waits for the sharp picture after it.
    #[track_caller]
    fn sharp_after(&self, work: impl FnOnce(&Browser)) -> String {
        self.value("document.getElementById('status').textContent = ''");
        work(self);
        self.sharp()
    }

    /// The picture that is shown, as its own bytes.
    fn picture(&self) -> String {
        self.value("document.getElementById('picture').toDataURL()").as_str().unwrap().into()
    }

    /// Presses at one place of the window, moves to another and lets go.
    fn drag(&self, from: (i64, i64), to: (i64, i64)) {
        let at = |(x, y): (i64, i64), ms: u32| json!({ "type": "pointerMove", "duration": ms, "x": x, "y": y });
        let steps = json!([at(from, 0), { "type": "pointerDown", "button": 0 }, at(to, 100), { "type": "pointerUp", "button": 0 }]);
        self.call("actions", &json!({ "actions": [{ "type": "pointer", "id": "mouse", "actions": steps }] }));
    }

    fn key(&self, key: &str) {
        let steps = json!([{ "type": "keyDown", "value": key }, { "type": "keyUp", "value": key }]);
        self.call("actions", &json!({ "actions": [{ "type": "key", "id": "keys", "actions": steps }] }));
    }

    /// Chooses a value as a person would.
    fn choose(&self, id: &str, value: &str) {
        let script = format!(
            "(() => {{ const it = document.getElementById('{id}'); it.value = '{value}'; it.dispatchEvent(new Event('change')); return it.value; }})()"
        );
        assert_eq!(self.value(&script), value, "{id} has no {value}");
    }

    /// The middle of an element, in the window.
    fn middle(&self, id: &str) -> (i64, i64) {
        let of = |side: &str, size: &str| {
            let script =
                format!("(b => b.{side} + b.{size} / 2)(document.getElementById('{id}').getBoundingClientRect())");
            self.value(&script).as_f64().unwrap() as i64
        };
        (of("left", "width"), of("top", "height"))
    }

    /// What the page's scripts complained of.
    fn complaints(&self) -> Vec<String> {
        let log = self.call("se/log", &json!({ "type": "browser" }));
        log.as_array().unwrap().iter().map(|entry| entry["message"].as_str().unwrap_or_default().to_string()).collect()
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        // Without it the driver's browser would go on.
        let _ = std::panic::catch_unwind(|| ask("DELETE", &self.session, "", ""));
        let _ = self.driver.kill();
        let _ = self.driver.wait();
    }
}

#[test]
#[ignore = "needs Chromium"]
fn pointer_wheel_and_keys_move_the_camera_and_the_view_brings_it_back() {
    served(vec![shown("one", Method::Nerf, 20)], |url, _| {
        let browser = Browser::open(url, 1200, 800);
        let first = browser.sharp();
        let (x, y) = browser.middle("picture");
        let turned = browser.sharp_after(|browser| browser.drag((x, y), (x + 120, y + 30)));
        assert_eq!(browser.value("own"), Value::Null, "the camera has left the view");
        let left = "[document.getElementById('photograph').disabled, document.getElementById('views').value].join()";
        assert_eq!(browser.value(left), "true,");
        let flown = browser.sharp_after(|browser| browser.key("w"));
        let back = browser.sharp_after(|browser| browser.key("s"));
        let wheel = json!([{ "type": "scroll", "x": x, "y": y, "deltaX": 0, "deltaY": 200 }]);
        let zoomed = browser.sharp_after(|browser| {
            browser.call("actions", &json!({ "actions": [{ "type": "wheel", "id": "wheel", "actions": wheel }] }));
        });
        let all = [&first, &turned, &flown, &zoomed];
        assert!(all.iter().enumerate().all(|(i, a)| all[..i].iter().all(|b| a != b)), "two pictures are the same");
        assert_eq!(turned, back, "one step ahead and one back");
        let reset = browser.sharp_after(|browser| drop(browser.value("document.getElementById('reset').click()")));
        assert_eq!(reset, first);
        assert_eq!(browser.value(left), "false,held-out:0");
        // Until depth is there, what is shown is marked.
        let depths = "document.getElementById('depths').hidden";
        let marked = "document.getElementById('stage').classList.contains('stale')";
        assert_eq!((browser.value(depths), browser.value(marked)), (true.into(), false.into()));
        let depth = browser.sharp_after(|browser| {
            let click = "(document.querySelectorAll('#layers input')[1].click(), MARKED)".replace("MARKED", marked);
            assert_eq!(browser.value(&click), true);
        });
        assert_ne!(depth, first);
        assert_eq!((browser.value(depths), browser.value(marked)), (false.into(), false.into()));
        let number = |id: &str| browser.value(&format!("Number(document.getElementById('{id}').textContent)")).as_f64();
        assert!(number("near").unwrap() < number("far").unwrap());
        assert_eq!(browser.complaints(), [""; 0]);
    });
}

#[test]
#[ignore = "needs Chromium"]
fn two_runs_have_a_slider_and_a_difference() {
    served(vec![shown("long", Method::Nerf, 30), shown("short", Method::Nerf, 2)], |url, _| {
        let browser = Browser::open(url, 1200, 800);
        let half = browser.sharp();
        assert_eq!(browser.value("document.getElementById('slider').hidden"), false);
        let labels = "[...document.querySelectorAll('.label')].map(label => label.textContent).join()";
        assert_eq!(browser.value(labels), "long,short");
        let (slider, (right, _)) = (browser.middle("slider"), browser.middle("picture"));
        browser.drag(slider, (right + 150, slider.1));
        let border = browser.value("border").as_f64().unwrap();
        assert!(border > 0.55, "{border}");
        assert_ne!(browser.picture(), half);
        browser.run("document.getElementById('slider').focus()");
        browser.key("\u{e012}");
        assert!(browser.value("border").as_f64().unwrap() < border, "the arrow moves the border");
        browser.choose("as", "difference");
        assert_eq!(browser.value("document.getElementById('slider').hidden"), true);
        assert_ne!(browser.picture(), half);
        browser.until("/^PSNR between the two: [0-9.]+ dB$/.test(document.getElementById('psnr').textContent)");
        assert_eq!(browser.complaints(), [""; 0]);
    });
}

#[test]
#[ignore = "needs Chromium"]
fn the_worst_case_stands_beside_the_clean_pass_and_a_ray_is_drawn() {
    served(vec![shown("one", Method::AugNerf, 10)], |url, _| {
        let browser = Browser::open(url, 1200, 800);
        let clean = browser.sharp();
        let factor = "document.getElementById('scale').disabled";
        assert_eq!(browser.value(factor), true, "there is nothing to scale");
        browser.sharp_after(|browser| drop(browser.value("document.querySelector('#sites input').click()")));
        assert_eq!(browser.value(factor), false);
        let both = browser.sharp_after(|browser| browser.choose("beside", "attack"));
        assert_ne!(both, clean);
        let right = browser.value("document.getElementById('right-label').textContent");
        assert!(right.as_str().unwrap().starts_with("worst case of "), "{right}");
        // Chosen with no site, it takes all.
        browser.value("document.querySelectorAll('#sites input:checked').forEach((box) => box.click())");
        browser.choose("beside", "");
        browser.choose("beside", "attack");
        assert_eq!(browser.value("document.querySelectorAll('#sites input:not(:checked)').length"), 0);
        // Beside the slider.
        let (x, y) = browser.middle("picture");
        browser.drag((x - 60, y), (x - 60, y));
        browser.until("document.getElementById('ray-note').textContent.includes('Dashed: worst case, RGB')");
        assert_eq!(browser.complaints(), [""; 0]);
    });
}

#[test]
#[ignore = "needs Chromium"]
fn two_people_look_at_once_and_a_lost_program_is_said() {
    let browsers = served(vec![shown("one", Method::Nerf, 10)], |url, _| {
        let browsers = [Browser::open(url, 900, 700), Browser::open(url, 900, 700)];
        let pictures = browsers.each_ref().map(|browser| browser.sharp());
        assert_eq!(pictures[0], pictures[1]);
        let (x, y) = browsers[0].middle("picture");
        let turned = browsers[0].sharp_after(|browser| browser.drag((x, y), (x + 100, y)));
        assert_ne!(turned, pictures[0]);
        assert_eq!(browsers[1].picture(), pictures[1], "the other's camera has moved");
        assert_eq!(browsers[0].value("document.getElementById('lost').hidden"), true);
        browsers
    });
    let before = browsers[0].picture();
    browsers[0].until("!document.getElementById('lost').hidden");
    assert_eq!(browsers[0].picture(), before, "the last picture stays");
}

#[test]
#[ignore = "needs Chromium"]
fn a_slow_model_is_seen_coarsely_first_and_its_reloaded_page_waits_for_nobody() {
    let slow = shown_with("slow", Method::Nerf, 0, |config| {
        (config.field.width, config.field.depth) = (256, 8);
        (config.sampling.coarse, config.sampling.fine) = (64, 64);
    });
    served(vec![slow], |url, server| {
        let browser = Browser::open(url, 900, 700);
        for _ in 0..2 {
            // The page says how large its picture is, and how long the sharp one takes.
            browser.until("/^[0-9]+ × [0-9]+ so far. Rendering 400 × 400: about [0-9]+ s …$/.test(document.getElementById('status').textContent)");
            let (x, y) = browser.middle("picture");
            browser.value("(window.notes = [], new MutationObserver(() => notes.push(document.getElementById('ray-note').textContent)).observe(document.getElementById('ray-note'), { childList: true }))");
            browser.drag((x, y), (x, y));
            browser.until("document.getElementById('ray-note').textContent.startsWith('RGB')");
            assert_eq!(browser.value("notes[0]"), "Waiting for the ray …");
            assert_eq!(browser.value("busy"), true, "the ray came before the sharp picture");
            browser.call("refresh", &json!({}));
        }
        drop(browser);
        while server.unfinished() > 0 {
            std::thread::sleep(PAUSE);
        }
    });
}
