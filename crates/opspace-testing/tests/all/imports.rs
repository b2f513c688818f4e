//! Imports between the files of a crate, read from its sources.
//!
//! A path is followed through re-exports to the file that defines its item, wherever it stands: in a `use` or in the
//! code. Tests, comments and strings are left out. A method that a file calls is no import.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

/// Module path in a crate; empty for lib.rs.
pub(crate) type Module = Vec<String>;

/// Re-exports that are followed at most, against re-exports in a circle.
const MAX_REEXPORTS: usize = 16;

/// One source file: what its `use` statements bring into it, and the paths in its code.
#[derive(Default)]
struct File {
    /// Imported paths by the name that they have in this file.
    names: BTreeMap<String, Vec<String>>,
    /// Modules of which all names are imported.
    globs: Vec<Vec<String>>,
    /// Paths in the code.
    paths: Vec<Vec<String>>,
}

/// Source files of a crate.
pub(crate) struct Sources(BTreeMap<Module, File>);

impl Sources {
    pub(crate) fn read(src: &Path) -> Self {
        let mut sources = Self(BTreeMap::new());
        sources.collect(src, &mut Vec::new());
        sources
    }

    pub(crate) fn of_texts(texts: &[(&str, &str)]) -> Self {
        let module =
            |name: &str| name.split("::").filter(|part| !part.is_empty()).map(str::to_owned).collect();
        Self(texts.iter().map(|(name, text)| (module(name), File::parse(text))).collect())
    }

    fn collect(&mut self, folder: &Path, module: &mut Module) {
        for entry in fs::read_dir(folder).expect("a source folder") {
            let path = entry.expect("a source file").path();
            let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
            if path.is_dir() {
                module.push(name);
                self.collect(&path, module);
                module.pop();
            } else if path.extension().is_some_and(|extension| extension == "rs") && name != "main" {
                let own = (!["lib", "mod"].contains(&name.as_str())).then_some(name);
                let text = fs::read_to_string(&path).expect("a source file");
                self.0.insert(module.iter().cloned().chain(own).collect(), File::parse(&text));
            }
        }
    }

    /// Modules that each module imports.
    pub(crate) fn imports(&self) -> BTreeMap<Module, BTreeSet<Module>> {
        let edges = |(module, file): (&Module, &File)| {
            let used = file.names.values().chain(&file.globs).chain(&file.paths);
            let targets = used.filter_map(|path| self.defining(module, path, 0));
            (module.clone(), targets.filter(|target| target != module).collect())
        };
        self.0.iter().map(edges).collect()
    }

    /// Module whose file defines the item that `path` names in `module`; `None` for other crates.
    fn defining(&self, module: &Module, path: &[String], reexports: usize) -> Option<Module> {
        let (first, rest) = path.split_first()?;
        let child = [module.as_slice(), std::slice::from_ref(first)].concat();
        let file = self.0.get(module)?;
        match first.as_str() {
            "crate" => self.descend(Module::new(), rest, reexports),
            "self" => self.descend(module.clone(), rest, reexports),
            "super" => {
                let parent = module[..module.len().checked_sub(1)?].to_vec();
                if rest.first().is_some_and(|next| next == "super") {
                    return self.defining(&parent, rest, reexports);
                }
                self.descend(parent, rest, reexports)
            }
            _ if self.0.contains_key(&child) => self.descend(child, rest, reexports),
            // `use name::...` of another crate has the name of that crate itself.
            name => match file.names.get(name) {
                Some(imported) if imported != path && reexports < MAX_REEXPORTS => {
                    self.defining(module, &[imported, rest].concat(), reexports + 1)
                }
                _ => None,
            },
        }
    }

    fn descend(&self, module: Module, path: &[String], reexports: usize) -> Option<Module> {
        let Some((first, rest)) = path.split_first() else { return Some(module) };
        let child = [module.as_slice(), std::slice::from_ref(first)].concat();
        if self.0.contains_key(&child) {
            return self.descend(child, rest, reexports);
        }
        let file = self.0.get(&module)?;
        if reexports < MAX_REEXPORTS {
            if let Some(imported) = file.names.get(first) {
                return self.defining(&module, &[imported, rest].concat(), reexports + 1);
            }
            let from_glob = |glob: &Vec<String>| {
                let found = self.defining(&module, &[glob.as_slice(), path].concat(), reexports + 1)?;
                (found != module).then_some(found)
            };
            if let Some(found) = file.globs.iter().find_map(from_glob) {
                return Some(found);
            }
        }
        Some(module)
    }
}

impl File {
    fn parse(text: &str) -> Self {
        let mut file = Self::default();
        let code = without_comments(text);
        let code = code.split("#[cfg(test)]\nmod").next().unwrap_or_default();
        let code = code.split("#[cfg(test)]\npub(crate) mod").next().unwrap_or_default();
        let tokens = tokens(code);
        let mut at = 0;
        while at < tokens.len() {
            if tokens[at] == "use" && tokens.get(at + 1).is_some_and(|next| next != "<") {
                let end = tokens[at..].iter().position(|token| token == ";").map_or(tokens.len(), |n| at + n);
                file.import(&tokens[at + 1..end], &mut Vec::new());
                at = end;
            } else if is_name(&tokens[at])
                && at.checked_sub(1).is_none_or(|last| !["::", "."].contains(&tokens[last].as_str()))
            {
                let mut path = vec![tokens[at].clone()];
                while tokens.get(at + 1).is_some_and(|next| next == "::")
                    && tokens.get(at + 2).is_some_and(|next| is_name(next))
                {
                    path.push(tokens[at + 2].clone());
                    at += 2;
                }
                if path.len() > 1 {
                    file.paths.push(path);
                }
                at += 1;
            } else {
                at += 1;
            }
        }
        file
    }

    /// Reads the tree of a `use` statement.
    fn import(&mut self, tree: &[String], prefix: &mut Vec<String>) {
        let length = prefix.len();
        let mut at = 0;
        while at < tree.len() {
            match tree[at].as_str() {
                "::" => at += 1,
                "{" => {
                    for branch in branches(&tree[at + 1..tree.len() - 1]) {
                        self.import(branch, prefix);
                    }
                    prefix.truncate(length);
                    return;
                }
                "*" => {
                    self.globs.push(prefix.clone());
                    prefix.truncate(length);
                    return;
                }
                "as" => {
                    self.names.insert(tree[at + 1].clone(), prefix.clone());
                    prefix.truncate(length);
                    return;
                }
                "self" if !prefix.is_empty() => at += 1,
                name => {
                    prefix.push(name.to_owned());
                    at += 1;
                }
            }
        }
        if let Some(name) = prefix.last() {
            self.names.insert(name.clone(), prefix.clone());
        }
        prefix.truncate(length);
    }
}

/// Parts of a list between its outer commas.
fn branches(list: &[String]) -> Vec<&[String]> {
    let mut depth = 0;
    let split = list.split(|token| {
        match token.as_str() {
            "{" => depth += 1,
            "}" => depth -= 1,
            _ => {}
        }
        depth == 0 && token == ","
    });
    split.filter(|branch| !branch.is_empty()).collect()
}

fn is_name(token: &str) -> bool {
    token.starts_with(|first: char| first.is_alphabetic() || first == '_')
}

/// Names, `::`, and single characters.
fn tokens(code: &str) -> Vec<String> {
    let mut found: Vec<String> = Vec::new();
    let mut in_name = false;
    for character in code.chars() {
        let part_of_name = character.is_alphanumeric() || character == '_';
        match found.last_mut() {
            Some(last) if part_of_name && in_name => last.push(character),
            Some(last) if character == ':' && last == ":" => last.push(':'),
            _ if !character.is_whitespace() => found.push(character.to_string()),
            _ => {}
        }
        in_name = part_of_name;
    }
    found
}

/// Text with comments removed and strings emptied.
fn without_comments(text: &str) -> String {
    let mut code = String::new();
    let mut rest = text;
    while let Some(first) = rest.chars().next() {
        let length = if rest.starts_with("//") {
            rest.find('\n').unwrap_or(rest.len())
        } else if let Some(end) = raw_string(rest) {
            end
        } else if first == '"' {
            string(rest)
        } else if let Some(end) = character(rest) {
            end
        } else {
            code.push(first);
            first.len_utf8()
        };
        rest = &rest[length..];
    }
    code
}

/// Length of the raw string at the beginning of a text.
fn raw_string(text: &str) -> Option<usize> {
    let hashes = text.strip_prefix('r')?.chars().take_while(|character| *character == '#').count();
    let inner = text[1 + hashes..].strip_prefix('"')?;
    let end = format!("\"{}", "#".repeat(hashes));
    Some(2 + hashes + inner.find(&end).map_or(inner.len(), |at| at + end.len()))
}

/// Length of the string at the beginning of a text.
fn string(text: &str) -> usize {
    let mut escaped = false;
    let end = text.char_indices().skip(1).find(|(_, character)| {
        let ends = *character == '"' && !escaped;
        escaped = *character == '\\' && !escaped;
        ends
    });
    end.map_or(text.len(), |(at, _)| at + 1)
}

/// Length of the character in quotes at the beginning of a text; a lifetime is none.
fn character(text: &str) -> Option<usize> {
    let inner = text.strip_prefix('\'')?;
    let length = match inner.strip_prefix('\\') {
        Some(escape) => 1 + escape.char_indices().skip(1).find(|(_, end)| *end == '\'')?.0,
        None => inner.chars().next()?.len_utf8(),
    };
    inner[length..].starts_with('\'').then_some(length + 2)
}
