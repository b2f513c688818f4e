//! Postures of an arm: the one that brings its tip to a place, the contacts of its links in it, and the tip itself.

pub mod own_body;
pub mod posture_at;
pub mod tip;
