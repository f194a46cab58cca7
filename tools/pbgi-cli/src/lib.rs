//! The commands of the program `pbgi`, and of the programs that do one of them: arguments in, facade, tables out.
//!
//! It must never use an engine crate: what a command does is a call of the facade `pbgi`.
#![forbid(unsafe_code)]

mod advice;
pub mod bake;
pub mod cli;
pub mod demo;
mod environment;
pub mod info;
mod manual;
pub mod shade;

use clap::{CommandFactory, Parser, Subcommand};
use clap_complete::Shell;
use pbgi::{EXIT_MISUSED, PbgiError};
use std::ffi::OsString;
use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;

/// Point-based global illumination for point clouds and meshes that are larger than memory
#[derive(Debug, Parser)]
#[command(name = "pbgi", version, max_term_width = 100, after_help = FIRST_STEPS, after_long_help = cli::EXIT_CODES_HELP)]
struct Pbgi {
    #[command(subcommand)]
    command: Command,
}

/// Where to begin.
const FIRST_STEPS: &str = "\
First steps:
  pbgi demo                                          a picture from nothing, in two minutes
  pbgi bake  room.glb --surfels 1M -o room.pbgi      a mesh or a point cloud becomes an octree file
  pbgi shade room.pbgi --scene room.glb --env-color 1,1,1 -o room.exr --preview room.png

`pbgi COMMAND -h` is a page about a command, `pbgi COMMAND --help` all there is to say.";

#[derive(Debug, Subcommand)]
enum Command {
    Bake(Box<bake::BakeArgs>),
    Shade(Box<shade::args::ShadeArgs>),
    Info(info::InfoArgs),
    Demo(demo::DemoArgs),
    /// Print completions for a shell
    ///
    /// For bash: pbgi completions bash > ~/.local/share/bash-completion/completions/pbgi
    Completions {
        /// The shell
        #[arg(value_enum)]
        shell: Shell,
    },
    /// Write the manual pages of all commands
    Man {
        /// Folder for the pages; it is made where it is missing
        #[arg(long, value_name = "FOLDER")]
        out: PathBuf,
    },
}

/// The program `pbgi`.
pub fn main() -> ExitCode {
    let arguments: Vec<OsString> = std::env::args_os().collect();
    run(&arguments).into()
}

/// Runs the program with `arguments`, of which the first is its name, and returns its exit code. Takes over the signals that stop a program,
/// and the hook of panics: for processes that do nothing else.
pub fn run(arguments: &[OsString]) -> u8 {
    if let Some(cure) = arguments.get(1).and_then(|first| advice::command_for(first)) {
        return cli::run("pbgi", |_| Err(PbgiError::usage(cure)));
    }
    let code = match Pbgi::try_parse_from(arguments) {
        Ok(Pbgi { command }) => run_command(command),
        // Help and version are errors to clap, with the code 0.
        Err(error) => {
            let _ = error.print();
            u8::try_from(error.exit_code()).unwrap_or(EXIT_MISUSED)
        }
    };
    // A process that is not a program of Rust flushes nothing of ours when it ends.
    let _ = std::io::stdout().flush();
    code
}

fn run_command(command: Command) -> u8 {
    match command {
        Command::Bake(args) => cli::run("pbgi bake", |cancel| bake::run(&args, cancel)),
        Command::Shade(args) => cli::run("pbgi shade", |cancel| shade::run(&args, cancel)),
        Command::Info(args) => cli::run("pbgi info", |cancel| info::run(&args, cancel)),
        Command::Demo(args) => cli::run("pbgi demo", |cancel| demo::run(&args, cancel)),
        Command::Completions { shell } => {
            cli::run("pbgi completions", |_| manual::print_completions(Pbgi::command(), shell))
        }
        Command::Man { out } => {
            cli::run("pbgi man", |_| manual::write_pages(Pbgi::command(), &out))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_are_consistent() {
        Pbgi::command().debug_assert();
    }

    #[test]
    fn every_command_fits_a_screen() {
        let mut all = Pbgi::command();
        all.build();
        let mut commands: Vec<_> = all.get_subcommands().cloned().collect();
        commands.push(all);
        for mut command in commands {
            let help = command.render_help().to_string();
            let lines = help.lines().count();
            assert!(lines <= 60, "{} has {lines} lines:\n{help}", command.get_name());
        }
    }
}
