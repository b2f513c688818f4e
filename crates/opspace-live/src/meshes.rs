//! Meshes of the robots shown: the files that their URDFs name, and no others.

use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// Beginning of the place of a mesh in the URDF of a log.
const FILE: &str = "file://";

/// Endings of the names of meshes that the page can read.
const KINDS: [&str; 3] = ["stl", "obj", "dae"];

/// Size of the header of a text in Common Data Representation, and of its length, bytes.
const TEXT_BEGIN: usize = 8;

/// Replaces the places of meshes in a URDF by `/mesh/K` with their numbers in `files`, to which further ones are added.
pub(crate) fn served(urdf: &str, files: &Mutex<Vec<PathBuf>>) -> String {
    let mut files = files.lock().unwrap_or_else(PoisonError::into_inner);
    let mut out = String::with_capacity(urdf.len());
    let mut rest = urdf;
    while let Some(at) = rest.find(FILE) {
        let begin = at + FILE.len();
        let end = rest[begin..].find(['"', '\'']).map_or(rest.len(), |end| begin + end);
        let path = Path::new(&rest[begin..end]);
        out += &rest[..at];
        if is_mesh(path) {
            let number = files.iter().position(|file| file == path).unwrap_or_else(|| {
                files.push(path.to_owned());
                files.len() - 1
            });
            out += &format!("/mesh/{number}");
        } else {
            out += &rest[at..end];
        }
        rest = &rest[end..];
    }
    out + rest
}

fn is_mesh(path: &Path) -> bool {
    let kind = path.extension().and_then(|kind| kind.to_str()).unwrap_or_default();
    KINDS.iter().any(|known| known.eq_ignore_ascii_case(kind)) && path.is_file()
}

/// Replaces the places of meshes, as [`served`] does, in a URDF that is a text in Common Data Representation; `None` if it is none.
pub(crate) fn served_message(message: &[u8], files: &Mutex<Vec<PathBuf>>) -> Option<Vec<u8>> {
    let (begin, text) = message.split_at_checked(TEXT_BEGIN)?;
    let text = std::str::from_utf8(text.strip_suffix(&[0])?).ok()?;
    let text = served(text, files);
    let length = u32::try_from(text.len() + 1).ok()?;
    Some([&begin[..4], &length.to_le_bytes(), text.as_bytes(), &[0]].concat())
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]
    use super::*;

    /// Files that a URDF names as meshes are numbered, each once; other files and missing ones are not served.
    #[test]
    fn only_meshes_are_served() {
        let folder = tempfile::tempdir().unwrap();
        let place = |name: &str| folder.path().join(name);
        let (hand, secret) = (place("hand.STL"), place("secret.txt"));
        std::fs::write(&hand, "solid").unwrap();
        std::fs::write(&secret, "secret").unwrap();
        let mesh = |path: &Path| format!("<mesh filename='file://{}'/>", path.display());
        let urdf = [&hand, &secret, &place("missing.stl"), &hand].map(|path| mesh(path)).concat();
        let files = Mutex::default();
        let expected = format!(
            "<mesh filename='/mesh/0'/>{}{}<mesh filename='/mesh/0'/>",
            mesh(&secret),
            mesh(&place("missing.stl"))
        );
        assert_eq!(served(&urdf, &files), expected);
        let mut message = vec![0, 1, 0, 0];
        message.extend((urdf.len() as u32 + 1).to_le_bytes());
        message.extend(urdf.as_bytes());
        message.push(0);
        let served = served_message(&message, &files).unwrap();
        assert_eq!(served[8..served.len() - 1], *expected.as_bytes());
        assert_eq!(served[4..8], (expected.len() as u32 + 1).to_le_bytes());
        assert_eq!(files.into_inner().unwrap(), [hand]);
        let none = Mutex::default();
        for bad in [&b""[..], b"\0\x01\0\0", &message[..20], b"\0\x01\0\0\x05\0\0\0abc\xff\0"] {
            assert_eq!(served_message(bad, &none), None);
        }
    }
}
