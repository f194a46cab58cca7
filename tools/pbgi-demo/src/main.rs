//! `pbgi demo` under its own name.
#![forbid(unsafe_code)]

use std::process::ExitCode;

fn main() -> ExitCode {
    pbgi_cli::demo::main()
}
