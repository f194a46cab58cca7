//! Frames of an animation: numbers in file names, and what turns from frame to frame.

use crate::shade::args::ShadeArgs;
use pbgi::PbgiError;
use std::ffi::OsString;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

/// Most frames of one run.
const FRAMES_MAX: u32 = 1_000_000;

/// Frame numbers, such as `1-20`, `0-100x10` (every tenth) or `7`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Frames {
    range: RangeInclusive<u32>,
    step: u32,
}

impl Frames {
    /// Reads a range.
    pub fn parse(text: &str) -> Result<Self, String> {
        let expected = || format!("`{text}` are no frames; expected such as 1-20, 0-100x10 or 7");
        let number = |text: &str| text.trim().parse::<u32>().map_err(|_| expected());
        let (range, step) = match text.split_once('x') {
            Some((range, step)) => (range, number(step)?),
            None => (text, 1),
        };
        let (first, last) = range.split_once('-').unwrap_or((range, range));
        let range = number(first)?..=number(last)?;
        if step == 0 || range.is_empty() || (range.end() - range.start()) / step >= FRAMES_MAX {
            return Err(expected());
        }
        Ok(Self { range, step })
    }

    /// The numbers in their order.
    pub fn numbers(&self) -> impl Iterator<Item = u32> {
        self.range.clone().step_by(self.step as usize)
    }
}

/// The options of a frame: its number in place of every run of `#` in a file name, of as many digits at least; turns
/// grow with it.
pub fn args_of(args: &ShadeArgs, number: u32) -> ShadeArgs {
    let mut args = args.clone();
    let paths = [
        Some(&mut args.octree),
        Some(&mut args.output),
        args.view.camera_file.as_mut(),
        args.gbuffer.gbuffer.as_mut(),
        args.points.receivers.as_mut(),
        args.light.env.as_mut(),
        args.output_options.preview.as_mut(),
        args.output_options.contact_sheet.as_mut(),
        args.output_options.stats_json.as_mut(),
        args.store.trace_pages.as_mut(),
    ];
    for path in paths.into_iter().flatten() {
        *path = numbered_path(path, number);
    }
    for name in args.view.scene.iter_mut().chain(&mut args.view.camera) {
        *name = numbered(name, number);
    }
    // Of the number alone, so that machines can share the frames.
    let steps = f64::from(number);
    let turn = (f64::from(args.animation.env_turn.unwrap_or(0.0)) * steps) as f32;
    if args.animation.env_turn.is_some() {
        args.light.env_rotate = Some(args.light.env_rotate.unwrap_or(0.0) + turn);
    }
    args.animation.camera_turned = args.animation.camera_turn * steps;
    args
}

/// Refuses frames that would overwrite each other.
pub fn check(args: &ShadeArgs) -> Result<(), PbgiError> {
    let output = &args.output_options;
    let others =
        [&output.preview, &output.contact_sheet, &output.stats_json, &args.store.trace_pages];
    for path in std::iter::once(&args.output).chain(others.into_iter().flatten()) {
        if !path.to_string_lossy().contains('#') {
            return Err(PbgiError::usage(format!(
                "{} is the same for all frames; put #### where the frame's number goes",
                path.display()
            )));
        }
    }
    Ok(())
}

fn numbered_path(path: &Path, number: u32) -> PathBuf {
    match path.to_str() {
        Some(text) => PathBuf::from(OsString::from(numbered(text, number))),
        None => path.to_owned(),
    }
}

/// `text` with `number` in place of every run of `#`.
fn numbered(text: &str, number: u32) -> String {
    let mut result = String::new();
    let mut rest = text;
    while let Some(start) = rest.find('#') {
        let end = rest[start..].find(|c| c != '#').map_or(rest.len(), |length| start + length);
        result.push_str(&rest[..start]);
        result.push_str(&format!("{number:0width$}", width = end - start));
        rest = &rest[end..];
    }
    result + rest
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[test]
    fn ranges_are_read() {
        let numbers = |text: &str| -> Vec<u32> { Frames::parse(text).unwrap().numbers().collect() };
        assert_eq!(numbers("3-6"), [3, 4, 5, 6]);
        assert_eq!(numbers("0-10x4"), [0, 4, 8]);
        assert_eq!(numbers("7"), [7]);
        for text in ["", "a", "5-3", "1-", "-3", "1-4x0", "1-2-3", "0-4000000000", "1.5"] {
            assert!(Frames::parse(text).is_err(), "{text}");
        }
    }

    #[test]
    fn numbers_have_as_many_digits_as_there_are_signs() {
        for (pattern, expected) in [
            ("a.####.exr", "a.0042.exr"),
            ("#/b#c", "42/b42c"),
            ("###", "042"),
            ("plain.exr", "plain.exr"),
        ] {
            assert_eq!(numbered(pattern, 42), expected);
        }
    }

    #[test]
    fn options_of_a_frame_have_its_number_and_its_turn() {
        let args = ShadeArgs::parse_from([
            "pbgi-shade",
            "o.##.pbgi",
            "-o",
            "f.##.exr",
            "--env",
            "e.#.exr",
            "--env-rotate",
            "10",
            "--env-turn=-1.5",
            "--camera-position=1,2,3",
            "--camera-target=0,0,0",
            "--camera-turn",
            "2",
            "--frames",
            "5-9x2",
        ]);
        let frame = args_of(&args, 9);
        assert_eq!(frame.octree, Path::new("o.09.pbgi"));
        assert_eq!(frame.output, Path::new("f.09.exr"));
        assert_eq!(frame.light.env.as_deref(), Some(Path::new("e.9.exr")));
        assert_eq!((frame.light.env_rotate, frame.animation.camera_turned), (Some(-3.5), 18.0));
        assert!(check(&args).is_ok());
        let same = ShadeArgs { output: "f.exr".into(), ..args };
        assert!(check(&same).unwrap_err().to_string().contains("####"));
    }
}
