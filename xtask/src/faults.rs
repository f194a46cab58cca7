//! Faults at run time: calls on files that fail, full disks, kills and second runs, over every program.
//!
//! A library that is loaded before the programs fails the n-th open, read, write, sync or rename of a file, or all writes once the disk is full, or
//! ends or stops the process at such a call (`faults/shim.c`). Whatever fails, a program ends with a code and a message that say what has failed,
//! inputs and old outputs are as they were or new ones are whole, and nothing else is left; what a kill leaves, the next run to the same output
//! removes.

mod bench;
mod judge;
mod scenario;

use crate::workspace::Workspace;
use bench::{Bench, Fault, KINDS};
use scenario::{SCENARIOS, Scenario};

/// Moments tried of each kind of call in each scenario: all, or so many spread over them.
#[derive(Clone, Copy)]
struct Moments {
    failures: u64,
    kills: u64,
}

/// Tries everything, or with `short` a few moments of each kind.
pub fn run(workspace: &Workspace, short: bool) -> Result<(), String> {
    if !cfg!(target_os = "linux") {
        return Err("faults are tried on Linux only".into());
    }
    let bench = Bench::new(workspace)?;
    let moments =
        if short { Moments { failures: 3, kills: 3 } } else { Moments { failures: 40, kills: 20 } };
    let (mut faults, mut runs) = (Vec::new(), 0);
    for scenario in SCENARIOS.iter().filter(|scenario| !(short && scenario.is_long)) {
        let found = try_scenario(&bench, scenario, moments)?;
        println!(
            "{}: {} runs, {} wrong; {} failures reported, {} kills left files for the next run to remove",
            scenario.name,
            found.runs,
            found.faults.len(),
            found.reported,
            found.left
        );
        for fault in &found.faults {
            println!("    {fault}");
        }
        runs += found.runs;
        faults.extend(found.faults);
    }
    faults.extend(judge::two_bakes(&bench)?);
    runs += 2;
    println!("faults: {runs} runs, {} wrong", faults.len());
    if faults.is_empty() { Ok(()) } else { Err(faults.join("\n")) }
}

/// What came of a scenario.
#[derive(Default)]
struct Found {
    runs: u64,
    /// Runs that ended with an error.
    reported: u64,
    /// Kills that left something.
    left: u64,
    faults: Vec<String>,
}

impl Found {
    /// Notes a run that is as it must be, and whether it counts, or what is wrong.
    fn note(
        &mut self,
        run: String,
        result: Result<bool, String>,
        counter: fn(&mut Self) -> &mut u64,
    ) {
        self.runs += 1;
        match result {
            Ok(counts) => *counter(self) += u64::from(counts),
            Err(why) => self.faults.push(format!("{run}: {why}")),
        }
    }
}

fn try_scenario(bench: &Bench, scenario: &Scenario, moments: Moments) -> Result<Found, String> {
    let reference = judge::Reference::new(bench, scenario)?;
    let mut found = Found::default();
    for (kind, calls) in KINDS.into_iter().zip(reference.calls) {
        for at in spread(calls, moments.failures) {
            let fault = Fault { kind, at, does: "fail" };
            let result = reference.try_failure(bench, scenario, &fault)?;
            found.note(format!("{}, {fault}", scenario.name), result, |found| &mut found.reported);
        }
        if kind == "full" {
            continue;
        }
        for at in spread(calls, moments.kills) {
            let fault = Fault { kind, at, does: "kill" };
            let result = reference.try_kill(bench, scenario, &fault)?;
            found.note(format!("{}, {fault}", scenario.name), result, |found| &mut found.left);
        }
    }
    if found.reported == 0 || found.left == 0 {
        found.faults.push(format!("{}: nothing failed, or no kill left anything", scenario.name));
    }
    Ok(found)
}

/// At most `count` of the numbers from 1 to `all`, the first and the last among them.
fn spread(all: u64, count: u64) -> Vec<u64> {
    let count = count.min(all);
    (0..count).map(|i| 1 + i * (all - 1) / (count - 1).max(1)).collect()
}

#[cfg(test)]
mod tests {
    use super::spread;

    #[test]
    fn moments_are_spread_from_the_first_to_the_last() {
        assert_eq!(spread(3, 10), [1, 2, 3]);
        assert_eq!(spread(101, 3), [1, 51, 101]);
        assert_eq!(spread(9, 1), [1]);
        assert_eq!(spread(0, 5), [0u64; 0]);
    }
}
