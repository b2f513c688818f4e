//! Object of a plant that frames of its arms hold.

use nalgebra::Vector3;
use opspace_model::FrameId;

/// Frame of an arm of a plant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PlantFrame {
    /// Index of the arm.
    pub arm: usize,
    /// Frame of that arm's model.
    pub frame: FrameId,
}

/// Rigid object that arms hold.
#[derive(Clone, Debug, PartialEq)]
pub struct PlantObject {
    /// Mass, kg.
    pub mass_kg: f64,
    /// Principal moments of inertia, kg m²; the principal axes are those of the world at the start.
    pub inertia_kg_m2: Vector3<f64>,
    /// Centre of mass at the start, m.
    pub position_m: Vector3<f64>,
    /// Gravitational acceleration, world axes, m/s².
    pub gravity_m_per_s2: Vector3<f64>,
    /// Time until which a support holds the object in place, s after the start of control.
    pub supported_until_s: f64,
    /// Grips of frames on the object.
    pub grips: Vec<PlantGrip>,
}

/// Springs and dampers between an object and the origin of a frame, relaxed where both are when the grip begins.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlantGrip {
    /// Frame that holds the object.
    pub frame: PlantFrame,
    /// Stiffness of the position, N/m.
    pub stiffness_n_per_m: f64,
    /// Damping of the position, Ns/m.
    pub damping_ns_per_m: f64,
    /// Stiffness of the orientation, Nm/rad.
    pub stiffness_nm_per_rad: f64,
    /// Damping of the orientation, Nms/rad.
    pub damping_nms_per_rad: f64,
    /// Beginning, s after the start of control.
    pub from_s: f64,
    /// End, s after the start of control.
    pub until_s: f64,
}

impl PlantObject {
    /// Returns the frames that hold the object, each once, in the order of their first grips.
    #[must_use]
    pub fn hands(&self) -> Vec<PlantFrame> {
        let mut hands = Vec::new();
        for grip in &self.grips {
            if !hands.contains(&grip.frame) {
                hands.push(grip.frame);
            }
        }
        hands
    }
}

impl PlantGrip {
    /// True if it exerts moments.
    #[must_use]
    pub fn has_moment(&self) -> bool {
        self.stiffness_nm_per_rad > 0.0 || self.damping_nms_per_rad > 0.0
    }
}
