//! Report of a run in a browser: everything is laid out and drawn, without messages on the console, and figures can be saved. `.ci/run browser`
//! installs Chromium and runs these tests.

#![expect(clippy::unwrap_used, clippy::expect_used, reason = "a test")]

use crate::cli_common::{opspace, project, read, run, scratch};
use serde_json::Value;
use std::fs;
use std::path::Path;
use std::process::Command;

/// Script that writes the layout of the page into its DOM: size and texts of each figure, all errors, and the files that the buttons
/// of the first figure save.
const PROBE: &str = r##"
<script>
const errors = [];
addEventListener("error", e => errors.push(e.message || "a resource"), true);
addEventListener("unhandledrejection", e => errors.push(String(e.reason)));
const saved = [], blobs = {};
const create = URL.createObjectURL;
URL.createObjectURL = blob => { const url = create.call(URL, blob); blobs[url] = blob; return url; };
HTMLAnchorElement.prototype.click = function () { saved.push({ name: this.download, blob: blobs[this.href] }); };
const wait = async (count) => { for (let k = 0; saved.length < count && k < 100; k++) await new Promise(r => setTimeout(r, 20)); };
addEventListener("load", async () => {
  const buttons = [...document.querySelectorAll("#figure-1 .save button")];
  buttons.forEach(button => button.click());
  await wait(buttons.length);
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
  const probe = document.createElement("pre");
  probe.id = "probe";
  probe.textContent = JSON.stringify({ errors, figures, files, clipped, rows: document.querySelectorAll("table tr").length,
    outside: document.documentElement.scrollWidth - document.documentElement.clientWidth });
  document.body.append(probe);
});
</script>
"##;

const BROWSERS: [&str; 4] = ["chromium", "chromium-browser", "google-chrome", "google-chrome-stable"];

fn browser() -> &'static str {
    let works = |name: &&&str| Command::new(name).arg("--version").output().is_ok_and(|o| o.status.success());
    BROWSERS.iter().find(works).unwrap_or_else(|| panic!("none of {BROWSERS:?} is installed"))
}

/// Returns the layout of a page in the browser.
fn probed(browser: &str, page: &Path) -> Value {
    let folder = page.parent().unwrap();
    let probing = folder.join("probing.html");
    fs::write(&probing, read(page).replacen("<head>", &format!("<head>{PROBE}"), 1)).unwrap();
    let output = Command::new(browser)
        .args(["--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-sync"])
        .args(["--disable-background-networking", "--disable-component-update", "--enable-logging=stderr"])
        .arg(format!("--user-data-dir={}", folder.join("profile").display()))
        .args(["--window-size=1200,900", "--virtual-time-budget=20000", "--dump-dom"])
        .arg(format!("file://{}", probing.display()))
        .output()
        .unwrap();
    let console = String::from_utf8_lossy(&output.stderr);
    let complaints: Vec<&str> = console.lines().filter(|line| line.contains(":CONSOLE")).collect();
    assert!(complaints.is_empty(), "{complaints:#?}");
    let dom = String::from_utf8(output.stdout).unwrap();
    let (_, rest) = dom.split_once("<pre id=\"probe\">").unwrap_or_else(|| panic!("no probe:\n{console}"));
    let json = rest.split_once("</pre>").unwrap().0;
    let json = json.replace("&lt;", "<").replace("&gt;", ">").replace("&amp;", "&");
    serde_json::from_str(&json).expect("what the probe says")
}

/// Checks that all figures are drawn, and returns their captions.
fn captions(probe: &Value) -> Vec<String> {
    assert_eq!(probe["errors"], serde_json::json!([]));
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
    let browser = browser();
    let folder = scratch();
    let log = run(folder.path(), "out", "compliant-x", &[]);
    let probe = probed(browser, &log.with_file_name("report.html"));
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

#[test]
#[ignore = "needs a browser: .ci/run browser"]
fn suite_report_is_drawn() {
    let browser = browser();
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
    let probe = probed(browser, &folder.path().join("out/report.html"));
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
    let browser = browser();
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
    let probe = probed(browser, &folder.path().join("out/report.html"));
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
    assert_eq!(probe["clipped"], serde_json::json!([]), "titles of axes that are cut off");
}
