//! Command line: one file per subcommand; doc comments are the help.
//!
//! Exit code 0 on success, 1 on a failed operation, 2 on wrong usage (by clap).

mod analyse;
mod bench;
mod blind_trial;
mod convert;
mod demo;
mod diagnose;
mod kernel;
pub mod node;
mod output;
mod progress;
mod verify;
mod simulate;
mod study;
mod tolerances;
mod with_effects;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

use crate::recording::silence_guarded_panics;

/// Railway crossing panel condition monitoring from sleeper accelerations
///
/// Start with `cpcm demo`: it needs no data and shows the whole chain.
#[derive(Parser)]
#[command(name = "cpcm", version, propagate_version = true, after_help = EXAMPLES)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

const EXAMPLES: &str = "Examples:
  cpcm demo
  cpcm analyse tests/data/field/reference-1 --out results";

#[derive(Subcommand)]
enum Command {
    Demo(demo::DemoArgs),
    Analyse(analyse::AnalyseArgs),
    Simulate(simulate::SimulateArgs),
    Kernel(kernel::KernelArgs),
    Node(node::NodeArgs),
    Diagnose(diagnose::DiagnoseArgs),
    BlindTrial(blind_trial::BlindTrialArgs),
    Verify(verify::VerifyArgs),
    Study(study::StudyArgs),
    Convert(convert::ConvertArgs),
    Bench(bench::BenchArgs),
}

/// Parses the command line, runs the subcommand and reports its outcome.
pub fn main() -> ExitCode {
    silence_guarded_panics();
    let result = match Cli::parse().command {
        Command::Demo(args) => args.run(),
        Command::Analyse(args) => args.run(),
        Command::Simulate(args) => args.run(),
        Command::Kernel(args) => args.run(),
        Command::Node(args) => args.run(),
        Command::Diagnose(args) => args.run(),
        Command::BlindTrial(args) => args.run(),
        Command::Verify(args) => args.run(),
        Command::Study(args) => args.run(),
        Command::Convert(args) => args.run(),
        Command::Bench(args) => args.run(),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            output::print_error(&error);
            ExitCode::FAILURE
        }
    }
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;

    #[test]
    fn property_every_subcommand_has_an_example() {
        let mut cli = Cli::command();
        cli.build();
        assert_has_example(&mut cli);
    }

    fn assert_has_example(command: &mut clap::Command) {
        let help = command.render_long_help().to_string();
        assert!(help.contains("Example"), "{}", command.get_name());
        command.get_subcommands_mut().filter(|s| s.get_name() != "help").for_each(assert_has_example);
    }
}
