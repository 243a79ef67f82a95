//! The front of the stack: the action `plan_surface` and the `patchmill` command. It computes nothing.

pub mod node;
pub mod options;
pub mod output_folder;
pub mod plan_command;
pub mod progress_line;
pub mod stack;
pub mod stage_watch;
pub mod summary;
