//! No layer of a crate imports, directly or through others, a layer that imports it.
//!
//! Compared: the imports between the files of each crate, without tests, and a list without cycles. The layers of a
//! crate are the files and folders in `src/`; those of a folder are the files and folders in it. A folder includes
//! the file of its name, which declares its modules; where it has code of its own, it is a layer of the folder too.

use crate::imports::{Module, Sources};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// Imports that are allowed in cycles: `Data` has fields of types that belong to one algorithm each, and every
/// algorithm needs `Data`.
const ALLOWED: [[&str; 3]; 3] = [
    ["opspace-model", "data", "cholesky"],
    ["opspace-model", "data", "coriolis"],
    ["opspace-model", "data", "derivatives"],
];

/// Name of a folder's own file among its layers.
const OWN: &str = "own file";

/// Layers that each layer imports, with the files of one such import.
type Layers = BTreeMap<String, BTreeMap<String, String>>;

#[test]
fn no_crate_has_an_import_cycle() {
    let mut cycles = Vec::new();
    let mut edges = 0;
    for (name, imports) in crates() {
        edges += imports.values().map(BTreeSet::len).sum::<usize>();
        cycles.extend(cycles_of(&imports).into_iter().map(|cycle| format!("{name}: {cycle}")));
    }
    assert!(edges > 1000, "only {edges} imports were found: the reader is wrong");
    assert!(cycles.is_empty(), "import cycles:\n{}", cycles.join("\n"));
}

/// Compared: the orders of layers in ARCHITECTURE.md, and the folders and imports, direct ones or through others, of each
/// crate that has folders.
#[test]
fn layers_are_in_the_order_of_the_architecture() {
    let page = fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("../../ARCHITECTURE.md"));
    let page = page.expect("the page of the architecture");
    let mut mistakes = Vec::new();
    for (name, imports) in crates() {
        let line = page.lines().find_map(|line| line.strip_prefix(&format!("* `{name}`: ")));
        let order: Vec<&str> = line.into_iter().flat_map(|line| line.split(" < ")).collect();
        let order: Vec<&str> = order.iter().map(|layer| layer.trim_matches('`')).collect();
        let modules = || imports.keys().filter(|module| !module.is_empty());
        let folders: BTreeSet<&str> =
            modules().filter(|module| module.len() > 1).map(|module| module[0].as_str()).collect();
        let missing = folders.iter().filter(|folder| !order.contains(folder));
        mistakes.extend(missing.map(|folder| format!("{name}: {folder} has no place")));
        let unknown = order.iter().filter(|layer| !modules().any(|module| module[0] == **layer));
        mistakes.extend(unknown.map(|layer| format!("{name}: there is no {layer}")));
        let layers = folders_of(&imports).remove(&Module::new()).unwrap_or_default();
        for (place, layer) in order.iter().enumerate() {
            let reached = reached(layer, &layers);
            let upward = order[place + 1..].iter().filter(|right| reached.contains(**right));
            mistakes.extend(upward.map(|right| match layers[*layer].get(*right) {
                Some(files) => format!("{name}: {layer} -> {right} ({files})"),
                None => format!("{name}: {layer} -> {right}, through others"),
            }));
        }
    }
    assert!(mistakes.is_empty(), "{}", mistakes.join("\n"));
}

/// Compared: a constructed crate whose files import each other in no circle but whose folders do, and its one cycle.
#[test]
fn cycle_of_folders_is_found() {
    let texts = [
        ("", "pub mod a; pub mod b; pub use b::{low::Low, high::High};"),
        ("a", "mod middle;"),
        ("a::middle", "use crate::Low; pub struct Middle(Low);"),
        ("b", "pub mod low; pub mod high;"),
        ("b::low", "pub struct Low;"),
        ("b::high", "use crate::a::middle::Middle; pub struct High(Middle);"),
    ];
    let cycle = "a -> b (a::middle imports b::low), b -> a (b::high imports a::middle)";
    assert_eq!(cycles_of(&Sources::of_texts(&texts).imports()), [cycle]);
    assert!(cycles_of(&Sources::of_texts(&texts[..5]).imports()).is_empty());
}

/// Compared: a folder whose file defines what a file in the folder imports, and the cycle of both.
#[test]
fn cycle_with_the_file_of_a_folder_is_found() {
    let texts = [("a", "mod b; pub struct A(b::B);"), ("a::b", "use super::A; pub struct B;")];
    let cycle = "a::b -> own file (a::b imports a), own file -> a::b (a imports a::b)";
    assert_eq!(cycles_of(&Sources::of_texts(&texts).imports()), [cycle]);
}

/// Compared: imports in all forms, and the files that define the items.
#[test]
fn imports_are_followed_to_their_definition() {
    let texts = [
        ("", "mod x; mod y; mod z; pub use x::deep::Deep; pub use y::*;"),
        ("x", "pub mod deep; pub use deep::{Deep, Other as Renamed};"),
        ("x::deep", "use std::fmt; pub struct Deep; pub struct Other;"),
        ("y", "pub use crate::x::Renamed; pub struct Y; // use crate::z;"),
        ("z", "use crate::{Deep, Renamed, x::{self, deep}};\nuse serde::z;"),
        ("z::all", "use super::super::Y; #[cfg(test)]\nmod tests { use crate::z; }"),
        ("z::code", "fn f() -> &'static str { crate::Deep::new('\"', r#\"crate::y::Y\"#); \"crate::y::Y\" }"),
    ];
    let imports = Sources::of_texts(&texts).imports();
    let of = |module: &str| {
        let module: Module = module.split("::").map(str::to_owned).collect();
        imports[&module].iter().map(|target| target.join("::")).collect::<Vec<_>>()
    };
    assert_eq!(of("z"), ["x", "x::deep"]);
    assert_eq!((of("z::all"), of("z::code"), of("y")), (vec!["y".to_owned()], of("y"), of("x")));
    assert!(of("x::deep").is_empty());
}

/// Names of all crates, and the imports of their modules without those that are allowed in cycles.
fn crates() -> Vec<(String, BTreeMap<Module, BTreeSet<Module>>)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let entries = fs::read_dir(&folder).expect("the folder of the crates");
    let roots = entries.map(|entry| entry.expect("a folder").path()).filter(|root| root.join("src").is_dir());
    let read = |root: PathBuf| {
        let name = root.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let name = if name == "ros2" { "opspace-ros2".to_owned() } else { name };
        let mut imports = Sources::read(&root.join("src")).imports();
        for [_, from, to] in ALLOWED.iter().filter(|[allowed, ..]| *allowed == name) {
            let targets = imports.get_mut(&vec![(*from).to_owned()]).expect("a file that imports");
            assert!(targets.remove(&vec![(*to).to_owned()]), "{name}: {from} does not import {to}");
        }
        (name, imports)
    };
    roots.chain([folder.join("../ros2")]).map(read).collect()
}

/// Layers of a crate and of each of its folders.
fn folders_of(imports: &BTreeMap<Module, BTreeSet<Module>>) -> BTreeMap<Module, Layers> {
    let mut folders: BTreeMap<Module, Layers> = BTreeMap::new();
    for (from, targets) in imports {
        for to in targets {
            let common = from.iter().zip(to).take_while(|(from, to)| from == to).count();
            let layer = |module: &Module| match module.get(common) {
                Some(_) => module[..=common].join("::"),
                None => OWN.to_owned(),
            };
            let files = format!("{} imports {}", from.join("::"), to.join("::"));
            let layers = folders.entry(from[..common].to_vec()).or_default();
            layers.entry(layer(from)).or_default().entry(layer(to)).or_insert(files);
        }
    }
    folders
}

/// Cycles between the layers of a crate and of each of its folders; one for layers that are in several.
fn cycles_of(imports: &BTreeMap<Module, BTreeSet<Module>>) -> Vec<String> {
    folders_of(imports).values().flat_map(cycles_of_layers).collect()
}

fn cycles_of_layers(layers: &Layers) -> Vec<String> {
    let reached: BTreeMap<&str, BTreeSet<&str>> =
        layers.keys().map(|layer| (layer.as_str(), reached(layer, layers))).collect();
    let mut done = BTreeSet::new();
    let mut cycles = Vec::new();
    for layer in layers.keys() {
        let is_member = |other: &str| {
            reached[layer.as_str()].contains(other)
                && reached.get(other).is_some_and(|r| r.contains(layer.as_str()))
        };
        if !is_member(layer) || !done.insert(layer.as_str()) {
            continue;
        }
        let members = layers.iter().filter(|(other, _)| is_member(other));
        let edges = members.flat_map(|(from, targets)| {
            let inner = targets.iter().filter(|(to, _)| is_member(to));
            inner.map(move |(to, files)| format!("{from} -> {to} ({files})"))
        });
        cycles.push(edges.collect::<Vec<_>>().join(", "));
        done.extend(layers.keys().map(String::as_str).filter(|other| is_member(other)));
    }
    cycles
}

/// Layers that a layer imports, directly or through others.
fn reached<'a>(layer: &'a str, layers: &'a Layers) -> BTreeSet<&'a str> {
    let mut found = BTreeSet::new();
    let mut open = vec![layer];
    while let Some(next) = open.pop() {
        let targets = layers.get(next).into_iter().flat_map(BTreeMap::keys).map(String::as_str);
        open.extend(targets.filter(|target| found.insert(*target)));
    }
    found
}
