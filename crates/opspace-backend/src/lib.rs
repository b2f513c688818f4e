//! Robots behind one trait: torque or position, and the transformer between them.
