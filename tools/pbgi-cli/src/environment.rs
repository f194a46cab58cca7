//! Arguments that name distant light.

use crate::cli::parse_triple;
use pbgi::{EnvironmentPlacement, EnvironmentSpec, LightSource, PbgiError};
use std::path::PathBuf;

/// Distant light.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Light")]
pub struct EnvironmentArgs {
    /// Equirectangular environment, EXR or HDR; see also --env-placement
    ///
    /// Its middle is seen along +Z (with +Z up, along -Y), a quarter from its left edge along +X, as OpenEXR and Mitsuba have it;
    /// --env-placement blender has the middle along +X.
    #[arg(long, value_name = "FILE", conflicts_with = "env_color")]
    pub env: Option<PathBuf>,
    /// Whose placement the environment has: openexr, mitsuba, blender, three; --env-rotate turns it on
    #[arg(long, value_name = "WHOSE", default_value = "openexr", requires = "env", value_parser = parse_placement, hide_short_help = true)]
    pub env_placement: EnvironmentPlacement,
    /// Uniform environment of this radiance
    #[arg(long, value_name = "R,G,B", value_parser = parse_triple, allow_hyphen_values = true)]
    pub env_color: Option<[f32; 3]>,
    /// Turn of the environment, counterclockwise seen from above
    #[arg(long, value_name = "DEGREES", allow_hyphen_values = true)]
    pub env_rotate: Option<f32>,
    /// Factor on the environment's radiance
    #[arg(long, value_name = "FACTOR", allow_hyphen_values = true, hide_short_help = true)]
    pub env_scale: Option<f32>,
}

fn parse_placement(name: &str) -> Result<EnvironmentPlacement, String> {
    EnvironmentPlacement::from_name(name)
        .ok_or_else(|| "expected openexr, mitsuba, blender or three".to_owned())
}

impl EnvironmentArgs {
    /// The environment asked for.
    ///
    /// # Errors
    ///
    /// [`PbgiError::Usage`] if one is turned or scaled and none is given.
    pub fn spec(&self) -> Result<Option<EnvironmentSpec>, PbgiError> {
        let file = self.env.clone().map(LightSource::File);
        let Some(source) = file.or(self.env_color.map(LightSource::Uniform)) else {
            let options = [
                ("--env-rotate or --env-turn", self.env_rotate.is_some()),
                ("--env-scale", self.env_scale.is_some()),
            ];
            return match options.iter().find(|(_, is_given)| *is_given) {
                Some((option, _)) => Err(PbgiError::usage(format!(
                    "{option} without an environment; add --env sky.hdr or --env-color 1,1,1"
                ))),
                None => Ok(None),
            };
        };
        Ok(Some(EnvironmentSpec {
            source,
            rotate_degrees: self.env_placement.rotate_degrees() + self.env_rotate.unwrap_or(0.0),
            scale: self.env_scale.unwrap_or(1.0),
        }))
    }
}
