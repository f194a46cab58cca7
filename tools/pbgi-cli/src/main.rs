//! All tools in one program.
#![forbid(unsafe_code)]

use std::process::ExitCode;

fn main() -> ExitCode {
    pbgi_cli::main()
}
