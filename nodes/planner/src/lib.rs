//! The front of the stack: the action `plan_surface` and the `patchmill` command. It computes nothing.

pub mod bag_command;
pub mod compare_command;
pub mod comparison;
pub mod dialect_command;
pub mod execute_command;
pub mod job_options;
pub mod linuxcnc_config_command;
pub mod machine_file;
pub mod node;
pub mod node_parameters;
pub mod options;
pub mod output_folder;
pub mod plan_command;
pub mod plan_folder;
pub mod plot_command;
pub mod progress_line;
pub mod replay;
pub mod replay_command;
pub mod report_command;
pub mod select_option;
pub mod session;
pub mod stack;
pub mod stage_watch;
pub mod stdout;
pub mod summary;
pub mod tool_option;
