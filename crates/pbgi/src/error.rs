//! Why a run ends, and the exit code that says so.

use crate::budget::reading::excess_of;
use pbgi_build::BuildError;
use pbgi_cloud::CloudError;
use pbgi_image::{ImageError, MetricsError};
use pbgi_light::EnvironmentError;
use pbgi_mesh::SceneError;
use pbgi_procedural::ProceduralError;
use pbgi_scene::{DiceError, HideError};
use pbgi_schedule::ScheduleError;
use pbgi_sort::SortError;
use pbgi_store::StoreError;
use std::error::Error;
use std::io;
use std::path::{Path, PathBuf};

/// Exit code of a run that failed for a reason of its own.
pub const EXIT_FAILED: u8 = 1;
/// Exit code of a command that cannot be carried out as given.
pub const EXIT_MISUSED: u8 = 2;
/// Exit code where an input cannot be read or is damaged.
pub const EXIT_INPUT: u8 = 3;
/// Exit code where disk or memory budget do not suffice.
pub const EXIT_RESOURCES: u8 = 4;
/// Exit code of an interrupted run.
pub const EXIT_INTERRUPTED: u8 = 130;

/// Why a run ended without its result.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PbgiError {
    /// The command cannot be carried out as given.
    #[error("{message}")]
    Usage {
        /// What is wrong, and what would be right.
        message: String,
    },
    /// An input is sound as a file, yet nothing can be made of it.
    #[error("{message}")]
    Input {
        /// File, place, what was found, what was expected.
        message: String,
    },
    /// The run failed for a reason of its own.
    #[error("{message}")]
    Failed {
        /// What happened, and what to do.
        message: String,
    },
    /// The memory limit does not suffice.
    #[error("{message}")]
    Budget {
        /// Bytes needed and granted, and what to do.
        message: String,
    },
    /// A result cannot be written.
    #[error("{}: {action} failed: {source}", path.display())]
    Output {
        /// The file.
        path: PathBuf,
        /// What was tried: "create", "write" …
        action: &'static str,
        /// The cause.
        source: io::Error,
    },
    /// A cloud failed.
    #[error(transparent)]
    Cloud(#[from] CloudError),
    /// A scene file failed.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// A text names no procedural scene.
    #[error(transparent)]
    Procedural(#[from] ProceduralError),
    /// A scene cannot be diced.
    #[error("{input}: {source}")]
    Dice {
        /// The scene.
        input: String,
        /// The cause.
        source: DiceError,
    },
    /// A scene cannot be hidden.
    #[error(transparent)]
    Hide(#[from] HideError),
    /// An image failed.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// Images cannot be compared.
    #[error(transparent)]
    Metrics(#[from] MetricsError),
    /// An image cannot be an environment.
    #[error("{}: {source}", path.display())]
    Environment {
        /// The image.
        path: PathBuf,
        /// The cause.
        source: EnvironmentError,
    },
    /// Sorting failed.
    #[error(transparent)]
    Sort(SortError),
    /// Building the octree failed.
    #[error(transparent)]
    Build(BuildError),
    /// An octree file failed.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// Shading failed.
    #[error(transparent)]
    Schedule(ScheduleError),
    /// Stopped by the user.
    #[error("interrupted")]
    Interrupted,
}

impl PbgiError {
    /// A [`PbgiError::Usage`].
    pub fn usage(message: impl Into<String>) -> Self {
        Self::Usage { message: message.into() }
    }

    /// A [`PbgiError::Input`].
    pub fn input(message: impl Into<String>) -> Self {
        Self::Input { message: message.into() }
    }

    /// A [`PbgiError::Failed`].
    pub fn failed(message: impl Into<String>) -> Self {
        Self::Failed { message: message.into() }
    }

    /// A [`PbgiError::Budget`].
    pub fn budget(message: impl Into<String>) -> Self {
        Self::Budget { message: message.into() }
    }

    /// A [`PbgiError::Output`] for `path`.
    pub fn output(path: &Path, action: &'static str, source: io::Error) -> Self {
        Self::Output { path: path.to_owned(), action, source }
    }

    /// The code a program ends with: 1 failed, 2 misused, 3 input unreadable or damaged, 4 out of
    /// disk or budget, 130 interrupted.
    #[must_use]
    pub fn exit_code(&self) -> u8 {
        if is_disk_full(self) || excess_of(self).is_some() {
            return EXIT_RESOURCES;
        }
        match self {
            Self::Usage { .. } | Self::Procedural(_) | Self::Hide(_) => EXIT_MISUSED,
            Self::Dice { source: DiceError::Spacing { .. }, .. } => EXIT_MISUSED,
            Self::Budget { .. }
            | Self::Sort(SortError::DiskFull { .. } | SortError::BudgetTooSmall { .. })
            | Self::Store(StoreError::Budget { .. })
            | Self::Schedule(ScheduleError::Store(StoreError::Budget { .. })) => EXIT_RESOURCES,
            Self::Cloud(CloudError::Io { action, .. })
            | Self::Sort(SortError::Cloud(CloudError::Io { action, .. }))
            | Self::Image(ImageError::Io { action, .. }) => io_exit_code(action),
            Self::Input { .. }
            | Self::Cloud(_)
            | Self::Scene(_)
            | Self::Dice { .. }
            | Self::Environment { .. }
            | Self::Sort(SortError::Cloud(_))
            | Self::Build(BuildError::Empty)
            | Self::Store(_)
            | Self::Schedule(ScheduleError::Store(_)) => EXIT_INPUT,
            Self::Image(ImageError::Unwritable { .. }) => EXIT_FAILED,
            Self::Image(_) => EXIT_INPUT,
            Self::Interrupted => EXIT_INTERRUPTED,
            Self::Failed { .. }
            | Self::Output { .. }
            | Self::Metrics(_)
            | Self::Sort(_)
            | Self::Build(_)
            | Self::Schedule(_) => EXIT_FAILED,
        }
    }
}

/// The exit code of an input or output error, told apart by what was tried.
fn io_exit_code(action: &str) -> u8 {
    if action.starts_with("open for reading") || action == "open" || action.starts_with("read") {
        EXIT_INPUT
    } else {
        EXIT_FAILED
    }
}

/// Whether the chain of causes ends at a disk or a quota that is used up.
fn is_disk_full(error: &PbgiError) -> bool {
    let mut cause: Option<&(dyn Error + 'static)> = Some(error);
    while let Some(error) = cause {
        let kind = error.downcast_ref::<io::Error>().map(io::Error::kind);
        if matches!(kind, Some(io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded)) {
            return true;
        }
        cause = error.source();
    }
    false
}

impl From<SortError> for PbgiError {
    fn from(error: SortError) -> Self {
        match error {
            SortError::Canceled => Self::Interrupted,
            SortError::Cloud(error) => Self::Cloud(error),
            error => Self::Sort(error),
        }
    }
}

impl From<ScheduleError> for PbgiError {
    fn from(error: ScheduleError) -> Self {
        match error {
            ScheduleError::Cancelled => Self::Interrupted,
            ScheduleError::Store(error) => Self::Store(error),
            error => Self::Schedule(error),
        }
    }
}

impl From<BuildError> for PbgiError {
    /// A stream of the facade fails with a [`PbgiError`], which comes out again unchanged.
    fn from(error: BuildError) -> Self {
        match error {
            BuildError::Cancelled => Self::Interrupted,
            BuildError::Stream(error) => match error.downcast::<Self>() {
                Ok(error) => *error,
                Err(error) => Self::Build(BuildError::Stream(error)),
            },
            error => Self::Build(error),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exit_codes_tell_who_has_to_act() {
        let path = Path::new("a.ply");
        let missing = || io::Error::from(io::ErrorKind::NotFound);
        let full = || io::Error::from(io::ErrorKind::StorageFull);
        let build = |source| BuildError::Io { path: path.to_owned(), action: "write", source };
        let cases: Vec<(PbgiError, u8)> = vec![
            (PbgiError::usage("x"), 2),
            (PbgiError::input("x"), 3),
            (PbgiError::budget("x"), 4),
            (CloudError::io(path, "open", missing()).into(), 3),
            (CloudError::io(path, "create", missing()).into(), 1),
            (CloudError::io(path, "write", full()).into(), 4),
            (CloudError::malformed(path, "row 3").into(), 3),
            (SceneError::io(path, "open", missing()).into(), 3),
            (ImageError::io(path, "open", missing()).into(), 3),
            (ImageError::io(path, "write", missing()).into(), 1),
            (build(missing()).into(), 1),
            (build(full()).into(), 4),
            (SortError::BudgetTooSmall { found: 1, expected: 2 }.into(), 4),
            (SortError::Canceled.into(), 130),
            (BuildError::Cancelled.into(), 130),
            (ScheduleError::Cancelled.into(), 130),
            (BuildError::Stream(Box::new(PbgiError::Interrupted)).into(), 130),
        ];
        for (error, code) in cases {
            assert_eq!(error.exit_code(), code, "{error:?}");
        }
    }
}
