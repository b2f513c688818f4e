//! Report of a run in a browser: everything is laid out and drawn, without messages on the console, and figures can be saved. `.ci/run browser`
//! installs Chromium and runs these tests.

#![expect(clippy::unwrap_used, reason = "a test")]

use crate::cli_common::{opspace, project, run, scratch};
use opspace_log::Recording;
use opspace_testing::browser::Browser;
use serde_json::{Value, json};
use std::fs;
use std::path::Path;

/// Script that runs before the page: it keeps the files that the buttons save in place of a download.
const KEEP_FILES: &str = r"
const saved = [], blobs = {};
const create = URL.createObjectURL;
URL.createObjectURL = blob => { const url = create.call(URL, blob); blobs[url] = blob; return url; };
HTMLAnchorElement.prototype.click = function () { saved.push({ name: this.download, blob: blobs[this.href] }); };
";

/// Expression of the layout of the page: size and texts of each figure, and the files that the buttons of the first figure save.
const PROBE: &str = r##"
(async () => {
  const buttons = [...document.querySelectorAll("#figure-1 .save button")];
  buttons.forEach(button => button.click());
  while (saved.length < buttons.length) await new Promise(r => setTimeout(r, 20));
  const files = [];
  for (const { name, blob } of saved) {
    const start = new Uint8Array(await blob.slice(0, 8).arrayBuffer());
    files.push({ name, type: blob.type, size: blob.size, start: [...start], text: blob.type.includes("svg") ? await blob.text() : "" });
  }
  const figures = [...document.querySelectorAll("figure")].map(figure => {
    const svg = figure.querySelector("svg[role=img]");
    const box = svg ? svg.getBoundingClientRect() : { width: 0, height: 0 };
    const shapes = svg ? [...svg.querySelectorAll("path, line, rect, circle, polyline")] : [];
    return {
      caption: figure.querySelector("figcaption").textContent,
      width: box.width,
      height: box.height,
      drawn: shapes.filter(s => s.getBoundingClientRect().width + s.getBoundingClientRect().height > 0).length,
      texts: svg ? [...svg.querySelectorAll("text")].map(t => t.textContent.trim()) : [],
    };
  });
  const clipped = [...document.querySelectorAll("figure:not(.views) svg")].flatMap(svg => {
    const box = svg.getBoundingClientRect();
    return [...svg.querySelectorAll("text")].filter(text => {
      const own = text.getBoundingClientRect();
      // The box of a rotated title has room above its letters.
      return own.left < box.left - 8 || own.right > box.right + 1 || own.top < box.top - 1 || own.bottom > box.bottom + 1;
    }).map(text => text.textContent.trim());
  });
  return { figures, files, clipped, rows: document.querySelectorAll("table tr").length,
    outside: document.documentElement.scrollWidth - document.documentElement.clientWidth };
})()
"##;

/// Returns the layout of a page in the browser, which writes nothing to the console.
fn probed(page: &Path) -> Value {
    let profile = scratch();
    let mut browser = Browser::start(profile.path(), 1200, 900);
    browser.call("Page.addScriptToEvaluateOnNewDocument", &json!({ "source": KEEP_FILES }));
    browser.open(&format!("file://{}", page.display()));
    let probe = browser.evaluate(PROBE);
    assert_eq!(browser.complaints(), [""; 0]);
    probe
}

/// Checks that all figures are drawn, and returns their captions.
fn captions(probe: &Value) -> Vec<String> {
    assert!(
        probe["outside"].as_f64().unwrap() <= 0.0,
        "the page is wider than its window: {}",
        probe["outside"]
    );
    assert!(probe["rows"].as_u64().unwrap() >= 2, "the table has a head and rows");
    let figures = probe["figures"].as_array().unwrap();
    for figure in figures {
        let (width, height) = (figure["width"].as_f64().unwrap(), figure["height"].as_f64().unwrap());
        assert!(width > 200.0 && height > 100.0, "{width} × {height}: {}", figure["caption"]);
        assert!(figure["drawn"].as_u64().unwrap() > 4, "nothing is drawn: {}", figure["caption"]);
    }
    figures.iter().map(|figure| figure["caption"].as_str().unwrap().to_owned()).collect()
}

/// Returns the texts in the figure whose caption contains `word`.
fn texts<'a>(probe: &'a Value, word: &str) -> Vec<&'a str> {
    let figures = probe["figures"].as_array().unwrap();
    let figure = figures.iter().find(|figure| figure["caption"].as_str().unwrap().contains(word));
    let figure = figure.unwrap_or_else(|| panic!("no figure of '{word}'"));
    figure["texts"].as_array().unwrap().iter().map(|text| text.as_str().unwrap()).collect()
}

const JOINTS: [&str; 4] = ["shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow"];

#[test]
#[ignore = "needs a browser: .ci/run browser"]
fn run_report_is_drawn() {
    let folder = scratch();
    let log = run(folder.path(), "out", "compliant-x", &[]);
    let probe = probed(&log.with_file_name("report.html"));
    let captions = captions(&probe);
    for figure in ["torque", "Position of 'hand'", "Force", "Setpoints"] {
        assert!(captions.iter().any(|caption| caption.contains(figure)), "{figure}: {captions:?}");
    }
    let [svg, png] = &probe["files"].as_array().unwrap()[..] else { panic!("two files: {}", probe["files"]) };
    assert_eq!([&svg["name"], &png["name"]], ["figure-1.svg", "figure-1.png"]);
    let text = svg["text"].as_str().unwrap();
    let is_drawing =
        text.starts_with("<svg xmlns=\"http://www.w3.org/2000/svg\"") && text.ends_with("</svg>");
    assert!(is_drawing && text.contains("fill=\"white\"") && text.matches("<text").count() > 10, "{text}");
    let signature = [137, 80, 78, 71, 13, 10, 26, 10].map(Value::from);
    assert!(png["start"].as_array().unwrap() == &signature && png["size"].as_u64() > Some(5000), "{png}");
    let torques = texts(&probe, "torque");
    assert!(JOINTS.iter().all(|joint| torques.contains(joint)), "a panel for each joint: {torques:?}");
    for figure in ["Position of", "Force on the frame"] {
        let texts = texts(&probe, figure);
        let is_titled = |axis: &str| texts.iter().any(|text| text.split(',').next() == Some(axis));
        assert!(["x", "y", "z"].into_iter().all(is_titled), "{figure}: {texts:?}");
    }
}

/// Checks that the player of a run is drawn and plays, that its hand is where the log says, and that a page without scripts has none.
#[test]
#[ignore = "needs a browser: .ci/run browser"]
fn player_plays() {
    let folder = scratch();
    let log = run(folder.path(), "out", "compliant-x", &["--set", "settle_s=0.5"]);
    let url = format!("file://{}", log.with_file_name("report.html").display());
    let profile = scratch();
    let mut browser = Browser::start(profile.path(), 1200, 900);
    browser.open(&url);
    // The code is unpacked after the page is there.
    browser.evaluate(
        "new Promise(done => { const look = () => window.opspaceView ? done() : setTimeout(look, 20); look(); })",
    );
    let drawn = browser.evaluate(
        "(async () => {
          opspaceView.toggle();
          const end = performance.now() + 30e3;
          while (opspaceView.time_s() < 0.5 && performance.now() < end) await new Promise(r => setTimeout(r, 20));
          opspaceView.toggle();
          const box = document.querySelector('.player canvas').getBoundingClientRect();
          const { x, y } = opspaceView.pixel('hand');
          return { pictures: opspaceView.drawn(), time_s: opspaceView.time_s(), width: box.width, height: box.height,
            inside: x > box.left && x < box.right && y > box.top && y < box.bottom,
            labels: [...document.querySelectorAll('.player .label')].map(label => label.textContent) };
        })()",
    );
    assert!(drawn["time_s"].as_f64().unwrap() >= 0.5 && drawn["pictures"].as_u64().unwrap() > 3, "{drawn}");
    assert!(drawn["width"].as_f64().unwrap() > 800.0 && drawn["height"].as_f64().unwrap() > 300.0, "{drawn}");
    assert!(drawn["inside"].as_bool().unwrap() && drawn["labels"].to_string().contains(" N"), "{drawn}");

    let recording = Recording::read(&log).unwrap();
    let tick = recording.tick().unwrap();
    let logged = tick.signal("hand.position").unwrap();
    for time_s in [0.0, 0.5, 1.5] {
        let frames = browser.evaluate(&format!("opspaceView.seek({time_s}), opspaceView.frames()"));
        let row = tick.time_s.partition_point(|t| *t < time_s - 1e-6);
        for (axis, position) in logged.row(row).iter().enumerate() {
            let shown = frames["hand"][axis].as_f64().unwrap();
            assert!(
                (shown - position).abs() < 1e-3,
                "axis {axis} at {time_s} s: {shown} m, not {position} m"
            );
        }
    }
    assert_eq!(browser.complaints(), [""; 0]);

    browser.call("Emulation.setScriptExecutionDisabled", &json!({ "value": true }));
    // Without scripts the page calls nothing back.
    browser.call("Page.navigate", &json!({ "url": format!("{url}?still") }));
    let is_there = "location.search === '?still' && document.readyState === 'complete'";
    while browser.evaluate(is_there) != json!(true) {
        std::thread::sleep(std::time::Duration::from_millis(50));
    }
    let player = browser.evaluate("document.querySelector('.player').getBoundingClientRect().height");
    assert_eq!(player, json!(0), "hidden without scripts");
    assert!(browser.evaluate("document.querySelectorAll('.views svg[role=img]').length").as_u64() >= Some(3));
}

#[test]
#[ignore = "needs a browser: .ci/run browser"]
fn suite_report_is_drawn() {
    let folder = scratch();
    let suite = format!(
        "title = \"Short\"\n{}{}",
        "[[run]]\ntasks = [\"TASKS/compliant-x.toml\", \"TASKS/joint-tracking.toml\"]\nbackend = \"torque\"\n\
         controller = \"osc\"\noverride = [\"duration_s=2.0\"]\n",
        "[[run]]\ntasks = [\"TASKS/compliant-x.toml\", \"TASKS/joint-tracking.toml\"]\nbackend = \"position\"\n\
         controller = \"ik\"\noverride = [\"duration_s=2.0\"]\n",
    );
    fs::write(folder.path().join("short.toml"), suite.replace("TASKS", &project("tasks"))).unwrap();
    opspace(folder.path(), &["bench", "short.toml", "--out", "out"]).exits(0);
    let probe = probed(&folder.path().join("out/report.html"));
    let captions = captions(&probe);
    for figure in ["Position error rms", "Operator force rms", "Hand motion rms", "torque", "Joint positions"]
    {
        assert!(captions.iter().any(|caption| caption.contains(figure)), "{figure}: {captions:?}");
    }
}

/// Checks the figures of a sweep of two settings: one per listed column and no other, a panel for each value of the second
/// setting, ticks at the values of the first, and titles of axes that are not cut off.
#[test]
#[ignore = "needs a browser: .ci/run browser"]
fn sweep_is_drawn() {
    let folder = scratch();
    let run = |controller: &str| {
        format!(
            "[[run]]\ntasks = [\"{}/press-table.toml\"]\nbackend = \"position\"\ncontroller = \"{controller}\"\n\
             seeds = [1, 2]\noverride = [\"duration_s=5.0\", \"task.hand.cartesian.force.admittance_ns_per_m=1000.0\"]\n",
            project("tasks")
        )
    };
    let suite = format!(
        "title = \"Two settings\"\ncolumns = [\"force-hold\", \"contact-peak\"]\n[grid]\n\
         \"environment.board.wall.stiffness_n_per_m\" = [1000.0, 10000.0, 50000.0]\n\
         \"robot.simulated.true_over_nominal.kp\" = [0.9, 1.1]\n{}{}",
        run("osc"),
        run("ik-lead")
    );
    fs::write(folder.path().join("short.toml"), suite).unwrap();
    opspace(folder.path(), &["bench", "short.toml", "--out", "out"]).exits(0);
    let probe = probed(&folder.path().join("out/report.html"));
    let captions = captions(&probe);
    let swept: Vec<&String> = captions.iter().filter(|caption| caption.contains(" over stiffness")).collect();
    assert_eq!(swept.len(), 2, "{captions:?}");
    assert!(
        captions[0].contains("Force error rms at rest")
            && captions[1].contains("Force max in first second of contact")
    );
    let texts = texts(&probe, "at rest over stiffness");
    for text in
        ["kp 0.9", "kp 1.1", "1000", "10000", "50000", "stiffness (N/m)", "force error (N)", "ik-lead"]
    {
        assert!(texts.contains(&text), "{text}: {texts:?}");
    }
    assert_eq!(probe["clipped"], json!([]), "titles of axes that are cut off");
}

#[test]
#[ignore = "needs a browser: .ci/run browser"]
fn complaints_of_a_page_are_seen() {
    let folder = scratch();
    let page = folder.path().join("page.html");
    fs::write(&page, "<img src=missing.png><script>console.warn('a warning'); no_such_function()</script>")
        .unwrap();
    let mut browser = Browser::start(&folder.path().join("profile"), 800, 600);
    browser.open(&format!("file://{}", page.display()));
    let complaints = browser.complaints().join("\n");
    for part in ["missing.png", "a warning", "no_such_function"] {
        assert!(complaints.contains(part), "{part}: {complaints}");
    }
    assert_eq!(browser.complaints(), [""; 0], "they are reported once");
}
