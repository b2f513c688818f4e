//! Properties of errors and of models, which several targets check.

use opspace_experiment::FileError;
use opspace_model::{Model, Placement};

/// Largest deviation of a rotation matrix from an orthonormal one.
const ROUNDING: f64 = 1e-9;

/// Checks that an error names one of the files, and points at a place that exists.
pub fn check_error(error: &FileError, files: &[&str]) {
    let text = error.to_string();
    assert!(!error.message().trim().is_empty(), "an empty message: {error:?}");
    assert!(files.contains(&error.path()), "names none of {files:?}: {error:?}");
    let code = error.code().map_or(String::new(), |code| format!(" [{code}]"));
    assert!(
        text.starts_with(error.path()) && text.ends_with(&format!("{}{code}", error.message())),
        "{text}"
    );
    assert!(!error.help().is_some_and(|help| help.trim().is_empty()), "an empty help: {error:?}");
    if let Some((shown, range)) = error.excerpt() {
        assert!(shown.get(range.clone()).is_some(), "{range:?} is no part of the text: {error:?}");
        if let Some(line) = error.line() {
            let before = shown[..range.start].matches('\n').count();
            assert_eq!(line, before + 1, "the line is not that of the excerpt: {error:?}");
        }
    }
}

/// Checks that all numbers of a model are finite, except for limits that may be absent, and possible.
pub fn check_model(model: &Model) {
    for body in model.bodies() {
        check_placement(&body.origin);
        let inertia = body.inertia;
        assert!(inertia.mass.is_finite() && inertia.mass >= 0.0, "{body:?}");
        assert!(inertia.com.iter().chain(&inertia.rotational).all(|x| x.is_finite()), "{body:?}");
        assert!(body.ratio.is_finite() && body.offset.is_finite(), "{body:?}");
        assert!(body.joint < model.n() && body.parent.is_none_or(|parent| parent < model.bodies().len()));
    }
    for frame in model.frames() {
        check_placement(&frame.placement);
        assert!(model.frame_id(&frame.name).is_ok(), "{frame:?}");
    }
    for joint in model.joints() {
        let limits = joint.limits;
        assert!(limits.lower <= limits.upper && limits.velocity >= 0.0 && limits.effort >= 0.0, "{joint:?}");
        assert!(!joint.name.is_empty());
    }
    assert!(
        model.total_mass().is_finite() && model.rotor_inertia().iter().all(|x| x.is_finite() && *x >= 0.0)
    );
}

fn check_placement(placement: &Placement) {
    assert!(placement.translation.iter().all(|x| x.is_finite()), "{placement:?}");
    let identity = placement.rotation * placement.rotation.transpose();
    let error = (identity - nalgebra::Matrix3::identity()).amax();
    assert!(error < ROUNDING, "no rotation: {placement:?}");
}
