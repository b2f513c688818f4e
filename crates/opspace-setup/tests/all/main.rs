//! Tests of the files of new robots.

mod arm_templates;
