//! Capsules of links in a log: a list in JSON.

use opspace_model::collision::{CapsuleSource, LinkCapsule};
use serde::{Deserialize, Serialize};

/// Form of [`CapsuleSource`] in a log.
#[derive(Serialize, Deserialize)]
#[serde(remote = "CapsuleSource", rename_all = "kebab-case")]
enum LoggedSource {
    Sphere,
    Cylinder,
    Capsule,
    Box,
    Mesh,
    Inertia,
    User,
}

/// Form of [`LinkCapsule`] in a log.
#[derive(Serialize, Deserialize)]
#[serde(remote = "LinkCapsule", deny_unknown_fields)]
struct LoggedCapsule {
    name: String,
    link: String,
    start_m: [f64; 3],
    end_m: [f64; 3],
    radius_m: f64,
    #[serde(with = "LoggedSource")]
    source: CapsuleSource,
}

#[derive(Serialize)]
struct Borrowed<'a>(#[serde(with = "LoggedCapsule")] &'a LinkCapsule);

#[derive(Deserialize)]
struct Owned(#[serde(with = "LoggedCapsule")] LinkCapsule);

/// Writes capsules as JSON.
pub(super) fn write_capsules(capsules: &[LinkCapsule]) -> serde_json::Result<Vec<u8>> {
    serde_json::to_vec(&capsules.iter().map(Borrowed).collect::<Vec<_>>())
}

/// Reads the capsules that [`write_capsules`] has written.
pub(super) fn read_capsules(json: &[u8]) -> serde_json::Result<Vec<LinkCapsule>> {
    let capsules: Vec<Owned> = serde_json::from_slice(json)?;
    Ok(capsules.into_iter().map(|Owned(capsule)| capsule).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Compared: the JSON of two capsules with the text in logs so far, and these capsules with those read from it.
    #[test]
    fn capsules_are_read_as_they_were_written() {
        let capsule = |name: &str, source| LinkCapsule {
            name: name.to_owned(),
            link: "hand".to_owned(),
            start_m: [0.1, -0.0, 1e-9],
            end_m: [1.0 / 3.0, 2.0, -3.5],
            radius_m: 0.05,
            source,
        };
        let capsules = [capsule("hand", CapsuleSource::Inertia), capsule("hand 2", CapsuleSource::User)];
        let numbers = r#""start_m":[0.1,-0.0,1e-9],"end_m":[0.3333333333333333,2.0,-3.5],"radius_m":0.05"#;
        let text = format!(
            r#"[{{"name":"hand","link":"hand",{numbers},"source":"inertia"}},{{"name":"hand 2","link":"hand",{numbers},"source":"user"}}]"#
        );
        let written = write_capsules(&capsules).expect("JSON");
        assert_eq!(String::from_utf8_lossy(&written), text);
        assert_eq!(read_capsules(text.as_bytes()).expect("capsules"), capsules);
        assert!(read_capsules(text.replace("radius_m", "radius").as_bytes()).is_err());
    }
}
