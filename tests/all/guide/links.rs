//! Links between the pages, and figures.

use crate::cli_common::{project, read};
use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

/// Largest size of a figure, bytes.
const LARGEST_FIGURE: u64 = 64_000;

/// Every relative link of the pages names a file, and a heading in it if it has one.
#[test]
fn links_lead_somewhere() {
    let mut count = 0;
    for page in pages() {
        let text = read(&page);
        for link in links(&text) {
            if link.contains("://") || link.starts_with("mailto:") {
                continue;
            }
            let (file, heading) = link.split_once('#').unwrap_or((&link, ""));
            let target = if file.is_empty() { page.clone() } else { parent(&page) + "/" + file };
            assert!(Path::new(&target).exists(), "{page}: {link}: no such file");
            if !heading.is_empty() && target.ends_with(".md") {
                assert!(headings(&read(&target)).contains(heading), "{page}: {link}: no such heading");
            }
            count += 1;
        }
    }
    assert!(count > 100, "{count} links");
}

/// In the book, the address of a page that was moved leads to a page, and that of a heading to a heading or a page.
#[test]
fn old_addresses_lead_to_pages() {
    let book: toml::Table = read(project("docs/book.toml")).parse().unwrap();
    let redirects = book["output"]["html"]["redirect"].as_table().unwrap();
    let path = |address: &str| {
        let page = address.trim_start_matches('/').replace("index.html", "README.md").replace(".html", ".md");
        project(&format!("docs/{page}"))
    };
    let mut with_headings = 0;
    for (old, new) in redirects {
        let new = new.as_str().unwrap();
        let (page, heading) = new.split_once('#').unwrap_or((new, ""));
        assert!(Path::new(&path(page)).exists(), "{old} leads to {new}: no such page");
        let is_heading = heading.is_empty() || headings(&read(path(page))).contains(heading);
        assert!(is_heading, "{old} leads to {new}: no such heading");
        let (old_page, old_heading) = old.split_once('#').unwrap_or((old, ""));
        assert!(!Path::new(&path(old_page)).exists(), "{old} is a page, and leads to {new}");
        if !old_heading.is_empty() {
            // The page itself must lead somewhere, and the heading elsewhere.
            let default = redirects[old_page].as_str().unwrap();
            assert!(new != default, "{old} leads where its page leads: {new}");
            with_headings += 1;
        }
    }
    assert!(with_headings > 30 && redirects.len() > 60, "{with_headings} of {} addresses", redirects.len());
}

/// Every figure is shown by a page, is small, and has a background of its own, so that it is readable on a dark page.
#[test]
fn figures_are_small_shown_and_readable_on_a_dark_page() {
    let text: String = pages().iter().map(read).collect();
    for folder in ["docs", "docs/figures"] {
        for entry in fs::read_dir(project(folder)).unwrap() {
            let path = entry.unwrap().path();
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            if !name.ends_with(".svg") {
                continue;
            }
            assert!(text.contains(&name), "{name} is on no page");
            let size = fs::metadata(&path).unwrap().len();
            assert!(size <= LARGEST_FIGURE, "{name}: {size} bytes");
            let has_background =
                read(&path).lines().nth(1).unwrap().ends_with("fill=\"#FFFFFF\" stroke=\"none\"/>");
            assert!(has_background, "{name}: its first element is not a white rectangle");
        }
    }
}

/// Pages of the documentation, of the project and of its crates, as paths.
fn pages() -> Vec<String> {
    let own = ["README.md", "ARCHITECTURE.md", "DESIGN.md", "CONTRIBUTING.md", "CHANGELOG.md"];
    let mut pages: Vec<String> = super::docs().iter().map(|page| project(page)).collect();
    pages.extend(own.map(project));
    for entry in fs::read_dir(project("crates")).unwrap() {
        let folder = entry.unwrap().path();
        let own = ["README.md", "DESIGN.md"].map(|name| folder.join(name));
        pages.extend(own.iter().filter(|page| page.exists()).map(|page| page.display().to_string()));
    }
    pages
}

fn parent(page: &str) -> String {
    Path::new(page).parent().unwrap().display().to_string()
}

/// Targets of links and figures outside of code.
fn links(text: &str) -> Vec<String> {
    let mut links = Vec::new();
    let mut is_code = false;
    for line in text.lines() {
        if line.trim_start().starts_with("```") {
            is_code = !is_code;
        }
        if is_code {
            continue;
        }
        for (begin, end) in [("](", ')'), ("src=\"", '"')] {
            let parts = line.split(begin).skip(1);
            links.extend(parts.filter_map(|part| part.split_once(end)).map(|(link, _)| link.to_owned()));
        }
    }
    links.retain(|link| !link.contains(' ') && !link.is_empty());
    links
}

/// Anchors of the headings outside of code, as forges derive them.
fn headings(text: &str) -> BTreeSet<String> {
    let mut is_code = false;
    let outside = text.lines().filter(|line| {
        is_code ^= line.trim_start().starts_with("```");
        !is_code
    });
    let headings = outside.filter_map(|line| line.strip_prefix('#'));
    headings.map(|line| anchor(line.trim_start_matches('#').trim())).collect()
}

fn anchor(heading: &str) -> String {
    let kept = |c: char| match c {
        ' ' => Some('-'),
        c if c.is_alphanumeric() || c == '-' || c == '_' => Some(c),
        _ => None,
    };
    heading.to_lowercase().chars().filter_map(kept).collect()
}
