//! The program `vdt`: see the library beside this file.

use std::process::ExitCode;

fn main() -> ExitCode {
    vdt_cli::run()
}
