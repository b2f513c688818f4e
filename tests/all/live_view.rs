//! Live view in a browser, with a real pointer: a hand pulls one axis of three robots, a page is killed in mid-drag, a log is scrubbed.
//! `.ci/run browser` installs Chromium and runs these tests.

#![expect(clippy::unwrap_used, clippy::print_stdout, reason = "a test, which says what was measured")]

use crate::cli_common::{command, opspace, project, scratch};
use opspace_experiment::Experiment;
use opspace_log::Recording;
use opspace_model::{Data, frame_placement, kinematics};
use opspace_testing::browser::Browser;
use serde_json::{Value, json};
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// Longest wait for a program or a page, s. A machine that does much else is slow.
const PATIENCE_S: u64 = 60;

/// Program with a view, and the address of its page.
pub struct Program {
    process: Child,
    pub page: String,
}

impl Program {
    /// Starts the program, and waits until it says where its view is.
    pub fn start(folder: &Path, arguments: &[&str]) -> Self {
        let mut process =
            command(folder, arguments).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
        let mut lines = BufReader::new(process.stderr.take().unwrap()).lines();
        let page = lines.find_map(|line| Some(line.unwrap().strip_prefix("view at ")?.to_owned()));
        let page = page.expect("the program says where its view is");
        std::thread::spawn(move || lines.for_each(drop));
        Self { process, page }
    }

    /// Kills the program, which has no time to end anything.
    pub fn kill(&mut self) {
        self.process.kill().unwrap();
        self.process.wait().unwrap();
    }

    /// Ends the program as Ctrl-C does, and returns its exit code.
    pub fn interrupt(mut self) -> Option<i32> {
        Command::new("kill").args(["-INT", &self.process.id().to_string()]).status().unwrap();
        let begin = Instant::now();
        while begin.elapsed() < Duration::from_secs(PATIENCE_S) {
            if let Some(status) = self.process.try_wait().unwrap() {
                return status.code();
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        panic!("it does not end");
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// Page of a view in a browser.
struct Page(Browser);

impl Page {
    /// Opens the page and waits until the robot is drawn.
    fn open(program: &Program, profile: &Path, size_px: [u32; 2]) -> Self {
        let mut page = Self(Browser::start(profile, size_px[0], size_px[1]));
        page.0.open(&program.page);
        page.wait_for("window.opspaceView && opspaceView.isConnected() && opspaceView.drawn() > 5");
        page
    }

    #[track_caller]
    fn wait_for(&mut self, condition: &str) {
        let begin = Instant::now();
        while self.0.evaluate(&format!("Boolean({condition})")) != true {
            assert!(begin.elapsed() < Duration::from_secs(PATIENCE_S), "{condition}");
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    /// Moves or presses the pointer.
    fn mouse(&mut self, kind: &str, [x, y]: [f64; 2], modifiers: u32, clicks: u32) {
        let held = if kind == "mouseReleased" { 0 } else { 1 };
        let button = if kind == "mouseMoved" && modifiers == 0 { "none" } else { "left" };
        self.0.call(
            "Input.dispatchMouseEvent",
            &json!({ "type": kind, "x": x, "y": y, "button": button, "buttons": held, "modifiers": modifiers, "clickCount": clicks }),
        );
    }

    fn point(&mut self, expression: &str) -> [f64; 2] {
        let point = self.0.evaluate(expression);
        let number = |place: usize, name: &str| {
            point
                .get(name)
                .or_else(|| point.get(place))
                .and_then(Value::as_f64)
                .unwrap_or_else(|| panic!("{point}"))
        };
        [number(0, "x"), number(1, "y")]
    }

    /// Selects the hand of a robot by a double-click, and pulls it with Ctrl, in a picture along y: 15 cm along x. Returns the place of
    /// the pointer.
    fn pull(&mut self, prefix: &str) -> [f64; 2] {
        self.0.evaluate("opspaceView.lookFrom(-Math.PI / 2, 0), 0");
        std::thread::sleep(Duration::from_millis(500));
        let at = self.point(&format!("opspaceView.pixel('hand', '{prefix}')"));
        for clicks in [1, 2] {
            self.mouse("mousePressed", at, 0, clicks);
            self.mouse("mouseReleased", at, 0, clicks);
        }
        self.wait_for("opspaceView.selected() !== ''");
        self.mouse("mouseMoved", at, CTRL, 0);
        self.mouse("mousePressed", at, CTRL, 1);
        self.wait_for("opspaceView.isHolding()");
        let to = self.point(&format!(
            "(([x, y, z]) => opspaceView.pixelOf([x + 0.15, y, z]))(opspaceView.frames('{prefix}').hand)"
        ));
        for k in 1..=2 {
            let part = |i: usize| at[i] + (to[i] - at[i]) * f64::from(k) / 2.0;
            self.mouse("mouseMoved", [part(0), part(1)], CTRL, 1);
        }
        to
    }

    /// Number of pictures that the page draws of so much of the run (s), which takes twenty times as long.
    fn pictures_of(&mut self, time_s: f64) -> u64 {
        self.set("Speed", "'0.05'", "change");
        self.wait_for("opspaceView.state().speed === 0.05");
        let now = |page: &mut Self| page.0.evaluate("[opspaceView.pictures(), opspaceView.time_s()]");
        let begin = now(self);
        let end_s = begin[1].as_f64().unwrap() + time_s;
        self.wait_for(&format!("opspaceView.time_s() > {end_s}"));
        let seen = now(self)[0].as_u64().unwrap() - begin[0].as_u64().unwrap();
        self.set("Speed", "'1'", "change");
        seen
    }

    /// Sets the value of a control of the page, which has this name for assistive programs, and tells the page.
    fn set(&mut self, name: &str, value: &str, event: &str) {
        let name = json!(name);
        self.0.evaluate(&format!(
            "(control => {{ control.value = {value}; control.dispatchEvent(new Event('{event}')); }})(\
             document.querySelector(`[aria-label=${{JSON.stringify({name})}}]`))"
        ));
    }
}

const CTRL: u32 = 2;

/// Pull of the hand on a robot, as its log has it.
struct Pull {
    /// Largest force along x, N.
    force_n: f64,
    /// Largest deviation of the hand from its place before the pull, along each axis, until a second after it, mm.
    away_mm: [f64; 3],
    /// Deviation at the end of the log, mm.
    rest_mm: [f64; 3],
}

impl Pull {
    fn of(log: &Path) -> Self {
        let log = Recording::read(log).unwrap();
        let [external, tick] = ["external", "tick"].map(|name| log.channel(name).unwrap());
        let (pull, force) = (external.signal("pull").unwrap(), external.signal("force").unwrap());
        let position = tick.signal("hand.position").unwrap();
        let pulled: Vec<usize> = (0..external.len()).filter(|k| pull.row(*k)[0] != 0.0).collect();
        let [first, last] = [pulled[0], pulled[pulled.len() - 1]].map(|k| external.time_s[k]);
        let at = |time_s: f64| tick.time_s.partition_point(|t| *t < time_s).min(tick.len() - 1);
        let place = |k: usize| -> [f64; 3] { position.row(k).try_into().unwrap() };
        let away = |k: usize| {
            let (now, home) = (place(k), place(at(first)));
            std::array::from_fn::<f64, 3, _>(|axis| 1e3 * (now[axis] - home[axis]).abs())
        };
        let mut away_mm = [0.0_f64; 3];
        for k in at(first)..at(last + 1.0) {
            away_mm = std::array::from_fn(|axis| away_mm[axis].max(away(k)[axis]));
        }
        // The last rows are those of the stop.
        let rest_mm = away(at(tick.time_s[tick.len() - 1] - 0.3));
        let force_n = (0..external.len()).map(|k| force.row(k)[0].abs()).fold(0.0, f64::max);
        Self { force_n, away_mm, rest_mm }
    }
}

/// Compared: the motion of three robots with the same task under the same pull. A position robot yields along x as a torque robot does, and along no other axis; inverse kinematics
/// does not yield. The log of the pulled robots replays, and simulates again, bit for bit.
#[test]
#[ignore = "needs a browser: .ci/run browser"]
fn hand_moves_the_compliant_axis_alone() {
    let folder = scratch();
    let program = Program::start(
        folder.path(),
        &[
            "run",
            &project("tasks/compliant-x.toml"),
            "--view=127.0.0.1:0",
            "--beside",
            "torque",
            "--beside",
            "ik",
            "--set",
            "environment={}",
            "--duration-s",
            "60",
            "--out",
            "out",
        ],
    );
    let mut page = Page::open(&program, &folder.path().join("profile"), [1280, 800]);
    page.wait_for("opspaceView.time_s() > 1.5");
    let to = page.pull("/position");
    std::thread::sleep(Duration::from_secs(2));
    let rate_hz = page.0.evaluate("opspaceView.picturesPerSecond()").as_f64().unwrap();
    let seen = page.pictures_of(0.5);
    page.mouse("mouseReleased", to, CTRL, 1);
    page.wait_for("!opspaceView.isHolding()");
    std::thread::sleep(Duration::from_secs(3));
    assert_eq!(page.0.complaints(), [""; 0]);
    drop(page);
    program.interrupt();
    let log = |robot: &str| folder.path().join(format!("out/{robot}/run.mcap"));
    let [position, torque, ik] = ["position", "torque", "ik"].map(|robot| Pull::of(&log(robot)));
    for (name, pull) in [("position", &position), ("torque", &torque), ("ik", &ik)] {
        let Pull { force_n, away_mm, rest_mm } = pull;
        println!(
            "{name}: pulled with up to {force_n:.1} N, moved by {away_mm:.1?} mm, {rest_mm:.2?} mm after it"
        );
    }
    println!(
        "three robots: {rate_hz:.0} pictures a second; {seen} pictures of 0.5 s of the run at a speed of 0.05"
    );
    // How many there are a second depends on what else the machine does; of each second of a slow run there are at least 15.
    assert!(seen >= 8 && rate_hz > 0.0);
    assert!(position.force_n >= 30.0 && position.away_mm[0] >= 50.0);
    for axis in [1, 2] {
        assert!(position.away_mm[axis] <= 1.2 * torque.away_mm[axis].max(1.0), "axis {axis}");
        assert!(position.rest_mm[axis] <= 1.2 * torque.rest_mm[axis].max(1.0), "axis {axis} returns");
    }
    assert!(ik.force_n >= 30.0 && ik.away_mm.iter().all(|mm| *mm < 1.0), "{:?}", ik.away_mm);
    for robot in ["position", "torque", "ik"] {
        let log = format!("out/{robot}/run.mcap");
        opspace(folder.path(), &["replay", &log]).exits(0);
        opspace(folder.path(), &["replay", "--simulate", &log]).exits(0);
    }
}

/// Modes and gains that the page changes are inputs of the run; a page that is killed lets go of the robot; and the page of the log shows
/// the robot at the time that is chosen.
#[test]
#[ignore = "needs a browser: .ci/run browser"]
fn page_changes_a_task_is_killed_and_shows_the_log() {
    let folder = scratch();
    let task = project("tasks/compliant-x.toml");
    let program = Program::start(
        folder.path(),
        &["run", &task, "--view=0", "--set", "environment={}", "--duration-s", "60", "--out", "out"],
    );
    let mut page = Page::open(&program, &folder.path().join("first"), [390, 844]);
    page.wait_for("opspaceView.time_s() > 1");
    let width =
        page.0.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth");
    assert_eq!(width, 0, "the page of a phone is as wide as its screen");
    page.set("Mode of axis x of hand", "'motion'", "change");
    page.wait_for(
        "opspaceView.state().robots[0].tasks.some(task => task.modes && task.modes.x === 'motion')",
    );
    page.set("Natural frequency of axis y of hand, rad/s", "Math.log(7)", "input");
    page.wait_for("opspaceView.state().robots[0].tasks.some(task => task.gains && Math.abs(task.gains.y.natural_frequency_rad_per_s - 7) < 0.01)");
    let now_s = page.0.evaluate("opspaceView.time_s()").as_f64().unwrap();
    page.wait_for(&format!("opspaceView.time_s() > {}", now_s + 0.5));
    page.set("Mode of axis x of hand", "'compliant'", "change");
    page.pull("");
    page.wait_for("opspaceView.handForce_n()[0] !== null");
    std::thread::sleep(Duration::from_secs(1));
    println!(
        "one robot: {:.0} pictures a second",
        page.0.evaluate("opspaceView.picturesPerSecond()").as_f64().unwrap()
    );
    assert_eq!(page.0.complaints(), [""; 0]);
    drop(page);
    std::thread::sleep(Duration::from_secs(1));
    program.interrupt();
    let log = Recording::read(folder.path().join("out/run.mcap")).unwrap();
    let [external, tick] = ["external", "tick"].map(|name| log.channel(name).unwrap());
    let pull = external.signal("pull").unwrap();
    let pulled = (0..external.len()).filter(|k| pull.row(*k)[0] != 0.0).count();
    assert!(
        pulled > 20 && pull.row(external.len() - 1)[0] == 0.0,
        "it is pulled in {pulled} cycles, and released"
    );
    let modes = tick.signal("hand.modes").unwrap();
    let mut modes: Vec<f64> = (0..tick.len()).map(|k| modes.row(k)[0]).collect();
    modes.dedup();
    assert_eq!(modes[modes.len() - 3..], [1.0, 0.0, 1.0], "compliant, motion, compliant");
    let frequency = tick.signal("target.hand.frequency_rad_per_s").unwrap();
    assert!((frequency.row(tick.len() - 1)[1] - 7.0).abs() < 0.01);
    opspace(folder.path(), &["replay", "out"]).exits(0);
    opspace(folder.path(), &["replay", "--simulate", "out"]).exits(0);

    let program = Program::start(folder.path(), &["view", "out", "--at", "0"]);
    let mut page = Page::open(&program, &folder.path().join("second"), [1280, 800]);
    page.0.evaluate("document.querySelector('[aria-label=Pause], [title=Pause]')?.click()");
    let position = tick.signal("hand.position").unwrap();
    for share in [0.9, 0.3] {
        let time_s = share * (tick.time_s[tick.len() - 1] - tick.time_s[0]);
        page.0.evaluate(&format!(
            "(slider => {{ slider.value = {time_s}; slider.dispatchEvent(new Event('input')); slider.dispatchEvent(new Event('change')); }})\
             (document.querySelector('.transport input[type=range]'))"
        ));
        let row = tick.time_s.partition_point(|t| *t < time_s).min(tick.len() - 1);
        let [x, y, z] = <[f64; 3]>::try_from(position.row(row)).unwrap();
        page.wait_for(&format!(
            "(([x, y, z]) => Math.hypot(x - {x}, y - {y}, z - {z}) < 0.01)(opspaceView.frames('').hand)"
        ));
    }
    assert_eq!(page.0.complaints(), [""; 0]);
}

/// Layout of a page: width beyond the screen (px), number of controls, those that are too small for a finger, and texts below 12 px.
const SMALL: &str = "(() => {
    const shown = [...document.querySelectorAll('button, select, input, summary')].filter(part => part.checkVisibility());
    const small = part => {
      const { width, height } = part.getBoundingClientRect();
      return width < 40 || height < 40 ? [`${part.getAttribute('aria-label') || part.title || part.textContent}: ${width} x ${height}`] : [];
    };
    const root = document.documentElement;
    const has = part => [...part.childNodes].some(node => node.nodeType === 3 && node.data.trim());
    const texts = [...document.querySelectorAll('body *:not(script, style, option)')].filter(part => has(part) && part.checkVisibility());
    const scale = part => part.ownerSVGElement ? part.ownerSVGElement.getBoundingClientRect().width / part.ownerSVGElement.viewBox.baseVal.width : 1;
    const tiny = part => {
      const size = parseFloat(getComputedStyle(part).fontSize) * scale(part);
      return size < 11.9 ? [`${part.textContent}: ${size}`] : [];
    };
    return [root.scrollWidth - root.clientWidth, shown.length, shown.flatMap(small), texts.flatMap(tiny)];
})()";

/// On a phone, in light and dark, a live page, the page of a log and a report are as wide as the screen; controls have the size of a finger, and
/// texts at least 12 px.
#[test]
#[ignore = "needs a browser: .ci/run browser"]
fn pages_fit_a_phone() {
    let folder = scratch();
    let task = project("tasks/compliant-x.toml");
    opspace(folder.path(), &["run", &task, "--duration-s", "2", "--out", "log", "--quiet"]);
    let beside = ["--beside", "torque", "--beside", "ik", "--duration-s", "60", "--out", "out"];
    let run = Program::start(folder.path(), &[&["run", &task, "--view=0"], &beside[..]].concat());
    let log = Program::start(folder.path(), &["view", "log", "--at", "0"]);
    let report = format!("file://{}", folder.path().join("log/report.html").display());
    let pages = [
        (&run.page, "opspaceView.time_s() > 1"),
        (&log.page, "opspaceView.drawn() > 5"),
        (&report, "opspaceView.drawn() > 0"),
    ];
    let mut page = Page(Browser::start(&folder.path().join("profile"), 390, 844));
    let phone = json!({ "width": 390, "height": 844, "deviceScaleFactor": 2, "mobile": true });
    page.0.call("Emulation.setDeviceMetricsOverride", &phone);
    page.0.call("Emulation.setTouchEmulationEnabled", &json!({ "enabled": true }));
    for scheme in ["light", "dark"] {
        let features = json!([{ "name": "prefers-color-scheme", "value": scheme }]);
        page.0.call("Emulation.setEmulatedMedia", &json!({ "features": features }));
        for (address, is_ready) in pages {
            page.0.open(address);
            page.wait_for(&format!("window.opspaceView && {is_ready}"));
            assert_eq!(
                page.0.evaluate("matchMedia('(prefers-color-scheme: dark)').matches"),
                scheme == "dark"
            );
            let found = page.0.evaluate(SMALL);
            println!("{scheme}, {address}: {found}");
            assert_eq!(found[0], 0, "{address} is wider than the screen");
            assert!(found[1].as_u64().unwrap() >= 4, "{address}: {found}");
            assert_eq!((&found[2], &found[3]), (&json!([]), &json!([])), "{address}");
        }
    }
    assert_eq!(page.0.complaints(), [""; 0]);
}

/// Robots whose bases coincide are drawn side by side. Compared: the place at which one of them is pulled, and force and target in its own
/// world, as its log has them; the other one is not pulled.
#[test]
#[ignore = "needs a browser: .ci/run browser"]
fn robots_with_one_base_are_drawn_and_pulled_apart() {
    const PULLED_N: f64 = 10.0;
    // The pointer goes 0.12 m beside the hand, which moves meanwhile; the arms are drawn 0.8 m apart.
    const TARGET_M: std::ops::Range<f64> = 0.08..0.2;
    let folder = scratch();
    let experiment = project("tasks/experiments/teleop-free.toml");
    let program = Program::start(
        folder.path(),
        &["run", &experiment, "--view=0", "--duration-s", "60", "--set", "settle_s=0.5", "--out", "out"],
    );
    let mut page = Page::open(&program, &folder.path().join("first"), [1280, 800]);
    page.wait_for("opspaceView.time_s() > 1");
    let legend = "[...document.querySelectorAll('#legend li')].map(item => item.textContent)";
    page.wait_for(&format!("{legend}[1].startsWith('leader: drawn ')"));
    let legend = page.0.evaluate(legend);
    assert_eq!(legend[0], "follower");
    assert!(legend[1].as_str().unwrap().ends_with(" m along y, as its base is that of follower"), "{legend}");
    // Along x, y is to the right.
    page.0.evaluate("opspaceView.lookFrom(0, 0), 0");
    std::thread::sleep(Duration::from_millis(500));
    let [follower, leader] =
        ["follower", "leader"].map(|name| page.point(&format!("opspaceView.pixel('base', '/{name}')")));
    assert!(leader[0] - follower[0] > 100.0, "{leader:?} {follower:?}");
    let at = page.point("opspaceView.pixel('hand', '/leader')");
    let home = page.point("opspaceView.frames('/leader').hand");
    page.mouse("mouseMoved", at, CTRL, 0);
    page.mouse("mousePressed", at, CTRL, 1);
    page.wait_for("opspaceView.isHolding()");
    let to = page.point(
        "(([x, y, z]) => opspaceView.pixelOf([x, y + 0.12, z], '/leader'))(opspaceView.frames('/leader').hand)",
    );
    page.mouse("mouseMoved", to, CTRL, 1);
    page.wait_for("opspaceView.handForce_n()[1] !== null");
    assert_eq!(page.0.evaluate("opspaceView.handForce_n()[0]"), Value::Null);
    std::thread::sleep(Duration::from_secs(1));
    page.mouse("mouseReleased", to, CTRL, 1);
    page.wait_for("!opspaceView.isHolding()");
    assert_eq!(page.0.complaints(), [""; 0]);
    drop(page);
    program.interrupt();
    let logs = ["follower", "leader"]
        .map(|name| Recording::read(folder.path().join(format!("out/{name}/run.mcap"))).unwrap());
    let [follower, leader] = logs.each_ref().map(|log| log.channel("external").unwrap());
    let [is_follower, is_leader] =
        [follower, leader].map(|channel| channel.signal("pull").unwrap().rows().any(|row| row[0] != 0.0));
    assert!(is_leader && !is_follower);
    let [target, force] = ["target", "force"].map(|name| leader.signal(name).unwrap());
    let largest_n = force.rows().map(|row| row[1]).fold(0.0, f64::max);
    let farthest_m = target.rows().map(|row| row[1] - home[1]).filter(|y| y.is_finite()).fold(0.0, f64::max);
    println!("pulled with up to {largest_n:.1} N, to {farthest_m:.3} m beside the hand");
    assert!(largest_n > PULLED_N && TARGET_M.contains(&farthest_m), "{largest_n} N, {farthest_m} m");
    for name in ["leader", "follower"] {
        opspace(folder.path(), &["replay", &format!("out/{name}/run.mcap")]).exits(0);
    }
    opspace(folder.path(), &["replay", "--simulate", "out"]).exits(0);

    opspace(folder.path(), &["report", "out"]).exits(0);
    let mut page = Page(Browser::start(&folder.path().join("second"), 1280, 800));
    page.0.open(&format!("file://{}", folder.path().join("out/report.html").display()));
    page.wait_for("window.opspaceView && opspaceView.drawn() > 0");
    page.wait_for(
        "document.querySelector('.player .robots').innerText.includes('as its base is that of follower')",
    );
    assert_eq!(page.0.complaints(), [""; 0]);
}

/// Compared: the hands of two arms that carry a rod, as their logs have them, and as the page of the logs and the player of the report show
/// them at several times; the rod is between them.
#[test]
#[ignore = "needs a browser: .ci/run browser"]
fn all_robots_of_a_run_are_shown() {
    let folder = scratch();
    let experiment = project("tasks/experiments/two-arms-carry.toml");
    let short = ["--duration-s", "2", "--set", "settle_s=0.5", "--out", "out", "--quiet"];
    opspace(folder.path(), &[&["run", experiment.as_str()], &short[..]].concat());
    let names = ["left", "right"];
    let logs = names.map(|name| Recording::read(folder.path().join(format!("out/{name}/run.mcap"))).unwrap());
    let models = logs.each_ref().map(|log| Experiment::of_log(log).unwrap().robot().model.clone());
    // Time on the robot's clock (s), and position (m) of a hand by forward kinematics of its log.
    let hand = |robot: usize, share: f64| {
        let (tick, model) = (logs[robot].channel("tick").unwrap(), &models[robot]);
        let row = (share * tick.len() as f64) as usize;
        let (q, mut data) = (tick.signal("q").unwrap().row(row), Data::new(model));
        kinematics(model, &mut data, q, &vec![0.0; q.len()]);
        let hand = frame_placement(model, &data, model.frame_id("hand").unwrap());
        (tick.time_s[row], <[f64; 3]>::from(hand.translation))
    };
    let is_at = |frames: &str, [x, y, z]: [f64; 3]| {
        format!("(([x, y, z]) => Math.hypot(x - {x}, y - {y}, z - {z}) < 0.01)({frames}.hand)")
    };
    let program = Program::start(folder.path(), &["view", "out", "--at", "0"]);
    let mut page = Page::open(&program, &folder.path().join("first"), [1280, 800]);
    page.0.evaluate("document.querySelector('[aria-label=Pause], [title=Pause]')?.click()");
    for share in [0.9, 0.4] {
        let time_s = hand(0, share).0;
        page.set("Time", &time_s.to_string(), "input");
        page.set("Time", &time_s.to_string(), "change");
        for (number, name) in names.iter().enumerate() {
            page.wait_for(&is_at(&format!("opspaceView.frames('/{name}')"), hand(number, share).1));
        }
    }
    assert_eq!(
        page.0.evaluate("opspaceView.state().robots.map(robot => robot.same_base_as)"),
        json!([null, null])
    );
    page.wait_for("document.querySelector('#legend').innerText.includes('left')");
    page.wait_for("[...document.querySelectorAll('.label')].some(label => label.textContent === 'load' && !label.hidden)");
    assert_eq!(page.0.complaints(), [""; 0]);
    drop(page);

    let report = folder.path().join("out/report.html");
    let mut page = Page(Browser::start(&folder.path().join("second"), 1280, 800));
    page.0.open(&format!("file://{}", report.display()));
    page.wait_for("window.opspaceView && opspaceView.drawn() > 0");
    assert_eq!(page.0.evaluate("opspaceView.robots()"), json!(names));
    let start_s = page.0.evaluate("opspaceView.time_s()").as_f64().unwrap();
    let begin_s = logs[0].channel("tick").unwrap();
    let phase = begin_s.signal("phase").unwrap();
    let first = (0..begin_s.len()).find(|row| phase.row(*row)[0] == 1.0).unwrap();
    for share in [0.9, 0.4] {
        let time_s = hand(0, share).0 - begin_s.time_s[first];
        page.0.evaluate(&format!("opspaceView.seek({time_s})"));
        for (number, name) in names.iter().enumerate() {
            page.wait_for(&is_at(&format!("opspaceView.frames('{name}')"), hand(number, share).1));
        }
    }
    assert!(start_s.abs() < 0.1);
    assert_eq!(page.0.complaints(), [""; 0]);
}
