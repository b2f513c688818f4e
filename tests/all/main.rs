//! Tests of the complete program: experiments, command line, logs, robots and suites.

mod acceptance;
mod allocation;
mod allow;
mod book_browser;
mod cli;
mod cli_common;
mod collision_cases;
mod collision_detection;
mod collision_motion;
mod collision_retraction;
mod common;
mod coupled;
mod coupled_suites;
mod driver_faults;
#[cfg(target_os = "linux")]
mod driver_terminal;
mod drivers;
mod dropout;
mod encoders_within_a_turn;
mod estimated_force;
mod exactness;
mod exit_codes;
mod experiments;
mod files;
mod friction;
mod guide;
mod hostile_inputs;
mod identification;
mod identified;
mod identified_without_current;
mod live_view;
mod logs;
mod model_samples;
mod mounting;
mod new_robot;
mod open;
mod plants;
mod posture;
mod replay;
mod report_browser;
mod result_files;
mod robot_layers;
mod robots;
mod robots_of_a_run;
mod safety;
mod said;
mod samples;
mod sensor_loads;
mod servo_bus;
mod singular_start;
mod suites;
mod torque_error_notes;
mod view_folders;

#[global_allocator]
static ALLOCATOR: opspace_testing::allocation::CountingAllocator =
    opspace_testing::allocation::CountingAllocator;
