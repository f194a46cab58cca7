//! Completions and manual pages, made from the arguments themselves.

use crate::cli;
use clap::Command;
use clap_complete::Shell;
use pbgi::PbgiError;
use std::path::Path;

/// Prints what a shell needs to complete the arguments of `command`.
pub fn print_completions(mut command: Command, shell: Shell) -> Result<(), PbgiError> {
    let name = command.get_name().to_owned();
    let mut text = Vec::new();
    clap_complete::generate(shell, &mut command, name, &mut text);
    cli::print(&String::from_utf8_lossy(&text))
}

/// Writes a page for `command` and one for each of its commands into `folder`.
pub fn write_pages(command: Command, folder: &Path) -> Result<(), PbgiError> {
    let fault = |source| PbgiError::output(folder, "write manual pages into", source);
    std::fs::create_dir_all(folder).map_err(fault)?;
    clap_mangen::generate_to(command, folder).map_err(fault)
}
