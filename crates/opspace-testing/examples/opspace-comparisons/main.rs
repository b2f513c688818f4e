//! The `opspace` program with what exists only for comparisons in simulation and can damage a real robot: transformers by
//! equation (K8) on a measured closed loop, and three handlings of singularities.
//!
//! `cargo run --release -p opspace-testing --example opspace-comparisons -- bench tasks/suites/singularity.toml`

mod literal_transformer;
#[cfg(test)]
mod tests;

use literal_transformer::LiteralTransformer;
use opspace_cli::{Extensions, main_with};
use opspace_experiment::{TransformerEntry, TransformerSetup, TransformerTraits};
use std::process::ExitCode;

fn main() -> ExitCode {
    main_with(extensions())
}

/// Extensions of the program.
fn extensions() -> Extensions {
    let (first, second) = (
        literal(
            "identified-literal",
            "equation (K8) on a measured closed loop: one joint without gravity and contact; simulation only",
            true,
        ),
        literal(
            "identified-open-loop",
            "second form of (K8), without the measured position: drifts; simulation only",
            false,
        ),
    );
    let corrected = "the same method, corrected by measured motor current";
    let transformers = [
        first.clone(),
        first.with_current_feedback(corrected),
        second.clone(),
        second.with_current_feedback(corrected),
    ];
    let extensions = Extensions::default().with_comparisons();
    transformers.into_iter().fold(extensions, Extensions::with)
}

/// Equation (K8) in its first form, which uses the measured position, or in its second one.
fn literal(name: &'static str, description: &'static str, is_measured: bool) -> TransformerEntry {
    let traits =
        TransformerTraits { needs_closed_loops: true, simulation_only: true, ..TransformerTraits::default() };
    let build = move |setup: &TransformerSetup<'_>| {
        let n = setup.model().n();
        if n > 1 {
            let message = format!(
                "transformer '{}' assumes that only the motor moves the joint, which holds for a single joint; this robot \
                 has {n} joints",
                setup.name()
            );
            let help = "use 'identified', which measures the velocity instead of predicting it";
            return Err(setup.refused(message, help));
        }
        let transformer =
            LiteralTransformer::new(&setup.closed_loops(), is_measured, setup.timing().period_s());
        match transformer {
            Ok(transformer) => Ok(Box::new(transformer) as _),
            Err((joint, error)) => Err(setup.joint_error("identified", joint, &error)),
        }
    };
    TransformerEntry::new(name, description, build).with_traits(traits)
}
