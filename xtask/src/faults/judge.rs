//! What must be so after a fault.

use super::bench::{Bench, Fault, KINDS, Run};
use super::scenario::{SCENARIOS, Scenario};
use std::fs;
use std::process::Command;
use std::thread;
use std::time::Duration;

/// Codes of a run that has failed for a reason of the system: failed, input unreadable, out of disk.
const CODES: [i32; 3] = [1, 3, 4];

/// Runs from which on a kill that does not come is wrong.
const TRIES: u32 = 4;

/// What a message says where the file is there, and only its folder could not be synced.
const WRITTEN: &str = "written, not synced";

/// What a message says where the disk is full, with what is free and needed.
const NO_ROOM: &str = "make room";

/// What a scenario does when nothing fails.
pub struct Reference {
    pub calls: [u64; KINDS.len()],
    /// Its outputs.
    outputs: Vec<Vec<u8>>,
    inputs: Vec<Option<Vec<u8>>>,
}

impl Reference {
    pub fn new(bench: &Bench, scenario: &Scenario) -> Result<Self, String> {
        bench.remove_others()?;
        let inputs = bench.inputs();
        let calls = bench.count(scenario)?;
        let outputs: Option<Vec<Vec<u8>>> = outputs(bench, scenario).into_iter().collect();
        let outputs = outputs.ok_or_else(|| format!("{} leaves no output", scenario.name))?;
        Ok(Self { calls, outputs, inputs })
    }

    /// Puts an old output in the place of each, or nothing. Returns them.
    fn prepare(
        &self,
        bench: &Bench,
        scenario: &Scenario,
        with_old: bool,
    ) -> Result<Vec<Option<Vec<u8>>>, String> {
        bench.remove_others()?;
        if with_old {
            for (name, bytes) in scenario.outputs.iter().zip(&self.outputs) {
                // Of the right kind by its first bytes.
                let old = [bytes, &b"old"[..]].concat();
                fs::write(bench.path(name), old).map_err(|e| format!("{name}: {e}"))?;
            }
        }
        Ok(outputs(bench, scenario))
    }

    /// Whether each output is as it was, or whole.
    fn check_outputs(
        &self,
        bench: &Bench,
        scenario: &Scenario,
        old: &[Option<Vec<u8>>],
    ) -> Result<Vec<bool>, String> {
        let mut are_new = Vec::new();
        for (index, found) in outputs(bench, scenario).into_iter().enumerate() {
            let name = scenario.outputs[index];
            let is_whole = found.as_ref().is_some_and(|f| is_whole(name, f, &self.outputs[index]));
            if found != old[index] && !is_whole {
                return Err(format!("{name} is neither as it was nor whole"));
            }
            are_new.push(is_whole);
        }
        if bench.inputs() != self.inputs {
            return Err("an input was changed".into());
        }
        Ok(are_new)
    }

    /// Runs a scenario with a fault that it must survive or report. Returns whether it reports it.
    ///
    /// The outer error is one of the bench.
    pub fn try_failure(
        &self,
        bench: &Bench,
        scenario: &Scenario,
        fault: &Fault,
    ) -> Result<Result<bool, String>, String> {
        let old = self.prepare(bench, scenario, fault.at.is_multiple_of(2))?;
        let run = bench.run(scenario, Some(fault))?;
        let judged = self.judge_failure(bench, scenario, fault, &old, &run);
        Ok(judged.map(|()| run.code != Some(0)))
    }

    fn judge_failure(
        &self,
        bench: &Bench,
        scenario: &Scenario,
        fault: &Fault,
        old: &[Option<Vec<u8>>],
        run: &Run,
    ) -> Result<(), String> {
        let said = run.said.trim();
        if said.contains("panicked") {
            return Err(format!("it panics: {said}"));
        }
        let are_new = self.check_outputs(bench, scenario, old)?;
        match run.code {
            // What it can do without, such as hints, may fail.
            Some(0) if are_new.iter().all(|is_new| *is_new) => {}
            Some(0) => return Err(format!("it succeeds without its outputs: {said}")),
            Some(code) if CODES.contains(&code) => {
                if !said.contains("os error") && !said.contains(NO_ROOM) {
                    return Err(format!("its message does not say what has failed: {said}"));
                }
                if fault.kind == "full" && code != 4 {
                    return Err(format!("it ends with {code}, expected 4: {said}"));
                }
                if are_new.iter().all(|is_new| *is_new) && !said.contains(WRITTEN) {
                    return Err(format!("it fails with all outputs written: {said}"));
                }
            }
            code => return Err(format!("it ends with {code:?}: {said}")),
        }
        self.check_rest(bench, scenario, scenario.keeps && run.code != Some(0))
    }

    /// Runs a scenario that is killed, and once more. Returns whether the kill left something else than outputs.
    ///
    /// The outer error is one of the bench.
    pub fn try_kill(
        &self,
        bench: &Bench,
        scenario: &Scenario,
        fault: &Fault,
    ) -> Result<Result<bool, String>, String> {
        // How many calls there are differs by a few from run to run, as threads come one before the other: the last may not come.
        let mut tries = 1;
        let (old, killed) = loop {
            let old = self.prepare(bench, scenario, fault.at.is_multiple_of(2))?;
            let killed = bench.run(scenario, Some(fault))?;
            if killed.code != Some(0) || tries == TRIES {
                break (old, killed);
            }
            tries += 1;
        };
        if killed.code.is_some() {
            return Ok(Err(format!("it was not killed, but ended with {:?}", killed.code)));
        }
        if let Err(why) = self.check_outputs(bench, scenario, &old) {
            return Ok(Err(why));
        }
        let is_left = self.check_rest(bench, scenario, false).is_err();
        let again = bench.run(scenario, None)?;
        if again.code != Some(0) {
            return Ok(Err(format!("the next run ends with {:?}: {}", again.code, again.said)));
        }
        let are_new = match self.check_outputs(bench, scenario, &old) {
            Ok(are_new) => are_new,
            Err(why) => return Ok(Err(format!("after the next run {why}"))),
        };
        if are_new.contains(&false) {
            return Ok(Err("the next run gives other bytes".into()));
        }
        Ok(self.check_rest(bench, scenario, false).map(|()| is_left))
    }

    /// Whether nothing else is in the folder.
    fn check_rest(&self, bench: &Bench, scenario: &Scenario, may_keep: bool) -> Result<(), String> {
        let mut rest = bench.others();
        rest.retain(|name| !scenario.outputs.contains(&name.as_str()));
        if rest.is_empty() || may_keep {
            Ok(())
        } else {
            Err(format!("it leaves {}", rest.join(", ")))
        }
    }
}

/// Whether a file is what a run makes of it where nothing fails: the same bytes, but for times in statistics and the order of readers in a
/// trace.
fn is_whole(name: &str, found: &[u8], reference: &[u8]) -> bool {
    match name.rsplit('.').next() {
        Some("json") => found.starts_with(b"{") && found.ends_with(b"}\n"),
        Some("trace") => is_whole_trace(found),
        _ => found == reference,
    }
}

/// Whether a trace of pages ends where its last chunk does: `PBGITRC1`, a count and as many words, then chunks of a reader, a count and as
/// many pairs.
fn is_whole_trace(bytes: &[u8]) -> bool {
    let word = |at: usize| {
        let word = bytes.get(at..at + 4)?.first_chunk()?;
        Some(u32::from_le_bytes(*word) as usize)
    };
    let Some(mut at) = word(8).map(|pages| 12 + 4 * pages) else { return false };
    while let Some(entries) = word(at + 4) {
        at += 8 + 8 * entries;
    }
    bytes.starts_with(b"PBGITRC1") && at == bytes.len()
}

fn outputs(bench: &Bench, scenario: &Scenario) -> Vec<Option<Vec<u8>>> {
    scenario.outputs.iter().map(|name| fs::read(bench.path(name)).ok()).collect()
}

/// A bake of an output that another bake works on ends at once, and the other is not disturbed: it is stopped in the middle of its writing.
pub fn two_bakes(bench: &Bench) -> Result<Option<String>, String> {
    let scenario = &SCENARIOS[0];
    let reference = Reference::new(bench, scenario)?;
    bench.remove_others()?;
    let stop = Fault { kind: "write", at: 1, does: "stop" };
    let first = bench.scenario(scenario, Some(&stop)).spawn().map_err(|e| e.to_string())?;
    let id = first.id().to_string();
    wait_until_stopped(&id)?;
    let second = bench.run(scenario, None)?;
    let mut resume = Command::new("kill");
    resume.args(["-CONT", &id]).status().map_err(|e| format!("kill: {e}"))?;
    let first = bench.finish(Ok(first), scenario.args)?;
    println!("two bakes of one output: 2 runs");
    if second.code != Some(1) || !second.said.contains("another bake") {
        return Ok(Some(format!("the second bake ends with {:?}: {}", second.code, second.said)));
    }
    if first.code != Some(0) {
        return Ok(Some(format!("the first bake ends with {:?}: {}", first.code, first.said)));
    }
    let none = vec![None; scenario.outputs.len()];
    let checked = reference.check_outputs(bench, scenario, &none);
    Ok(checked.and_then(|_| reference.check_rest(bench, scenario, false)).err())
}

/// Waits for a process to stop.
fn wait_until_stopped(id: &str) -> Result<(), String> {
    for _ in 0..10_000 {
        let text = fs::read_to_string(format!("/proc/{id}/stat")).map_err(|e| e.to_string())?;
        if text.rsplit(')').next().is_some_and(|rest| rest.trim_start().starts_with('T')) {
            return Ok(());
        }
        thread::sleep(Duration::from_millis(1));
    }
    Err("the first bake does not stop".into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn statistics_and_traces_are_whole_where_they_end() {
        assert!(is_whole("a.json", b"{\"a\": 2}\n", b"{\"a\": 1}\n"));
        assert!(!is_whole("a.json", b"{\"a\": 2", b"{\"a\": 1}\n"));
        assert!(is_whole("a.pbgi", b"x", b"x") && !is_whole("a.pbgi", b"x", b"xy"));
        let words = |words: &[u32]| -> Vec<u8> {
            let words = words.iter().flat_map(|word| word.to_le_bytes());
            b"PBGITRC1".iter().copied().chain(words).collect()
        };
        let trace = words(&[1, 500, 0, 2, 7, 1, 8, 3, 0, 0]);
        assert!(is_whole("a.trace", &trace, b""));
        for end in [0, 9, 14, 20, trace.len() - 5] {
            assert!(!is_whole("a.trace", &trace[..end], b""), "{end}");
        }
    }
}
