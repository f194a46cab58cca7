//! Shading of points in arrays, into arrays.

use crate::run::{raise, run, warn};
use crate::settings::Shading as Settings;
use numpy::{
    PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray2, PyReadwriteArray1, PyReadwriteArray2,
};
use pbgi::{DVec3, PbgiError, Positions, ReceiversRequest, Shading, shade_receivers};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::PathBuf;

/// Positions of either precision.
#[derive(FromPyObject)]
pub enum Places<'py> {
    /// Single.
    F32(PyReadonlyArray2<'py, f32>),
    /// Double.
    F64(PyReadonlyArray2<'py, f64>),
}

/// A quantity that results have.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Quantity {
    Irradiance,
    SurfaceIrradiance,
    SkyIrradiance,
    AmbientOcclusion,
    SkyVisibility,
    BentNormal,
    SpecularIndirect,
}

impl Quantity {
    const ALL: [(&'static str, Self); 7] = [
        ("irradiance", Self::Irradiance),
        ("surface_irradiance", Self::SurfaceIrradiance),
        ("sky_irradiance", Self::SkyIrradiance),
        ("ambient_occlusion", Self::AmbientOcclusion),
        ("sky_visibility", Self::SkyVisibility),
        ("bent_normal", Self::BentNormal),
        ("specular_indirect", Self::SpecularIndirect),
    ];

    fn from_name(name: &str) -> Result<Self, PbgiError> {
        let found = Self::ALL.iter().find(|(known, _)| *known == name);
        found.map(|(_, quantity)| *quantity).ok_or_else(|| {
            let known: Vec<&str> = Self::ALL.iter().map(|(known, _)| *known).collect();
            PbgiError::usage(format!(
                "results: there is no `{name}`; there are {}",
                known.join(", ")
            ))
        })
    }

    fn is_scalar(self) -> bool {
        matches!(self, Self::AmbientOcclusion | Self::SkyVisibility)
    }

    /// The quantity of a result; scalars come first.
    fn of(self, shading: &Shading) -> [f32; 3] {
        match self {
            Self::Irradiance => shading.irradiance(),
            Self::SurfaceIrradiance => shading.surface_irradiance,
            Self::SkyIrradiance => shading.environment_irradiance,
            Self::AmbientOcclusion => [shading.ambient_occlusion; 3],
            Self::SkyVisibility => [shading.sky_visibility; 3],
            Self::BentNormal => shading.bent_normal.to_array(),
            Self::SpecularIndirect => shading.reflected,
        }
    }
}

/// An array of results, borrowed for writing.
enum Target<'py> {
    Scalars(PyReadwriteArray1<'py, f32>),
    Triples(PyReadwriteArray2<'py, f32>),
}

impl<'py> Target<'py> {
    /// A new array of zeros in `results`.
    fn create(
        results: &Bound<'py, PyDict>,
        name: &str,
        rows: usize,
        is_scalar: bool,
    ) -> PyResult<Self> {
        let py = results.py();
        if is_scalar {
            let array = PyArray1::zeros(py, rows, false);
            results.set_item(name, &array)?;
            return Ok(Self::Scalars(array.readwrite()));
        }
        let array = PyArray2::zeros(py, [rows, 3], false);
        results.set_item(name, &array)?;
        Ok(Self::Triples(array.readwrite()))
    }

    fn values(&mut self) -> PyResult<&mut [f32]> {
        Ok(match self {
            Self::Scalars(array) => array.as_slice_mut()?,
            Self::Triples(array) => array.as_slice_mut()?,
        })
    }
}

/// Shades points: rows of `positions` and `normals`, which are contiguous. The arrays asked for by name, and the report as JSON.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "arguments of a Python function")]
pub fn shade<'py>(
    py: Python<'py>,
    octree: PathBuf,
    positions: Places<'py>,
    normals: PyReadonlyArray2<'py, f32>,
    skip_empty: bool,
    eye: Option<[f64; 3]>,
    names: Vec<String>,
    settings: Settings,
    progress: Option<Py<PyAny>>,
) -> PyResult<(Bound<'py, PyDict>, String)> {
    let settings = settings.settings().map_err(|error| raise(py, &error))?;
    let quantities: Result<Vec<Quantity>, _> =
        names.iter().map(|name| Quantity::from_name(name)).collect();
    let quantities = quantities.map_err(|error| raise(py, &error))?;
    if settings.gloss.is_none() && quantities.contains(&Quantity::SpecularIndirect) {
        let message =
            "results: `specular_indirect` needs glossy surfaces; give gloss=True or a roughness";
        return Err(raise(py, &PbgiError::usage(message)));
    }
    let positions = match &positions {
        Places::F32(places) => Positions::F32(places.as_slice()?.as_chunks().0),
        Places::F64(places) => Positions::F64(places.as_slice()?.as_chunks().0),
    };
    let normals = normals.as_slice()?.as_chunks().0;
    let results = PyDict::new(py);
    let targets = names.iter().zip(&quantities).map(|(name, quantity)| {
        Target::create(&results, name, normals.len(), quantity.is_scalar())
    });
    let mut targets = targets.collect::<PyResult<Vec<_>>>()?;
    let values = targets.iter_mut().map(Target::values);
    let values = values.collect::<PyResult<Vec<&mut [f32]>>>()?;
    let mut outputs: Vec<(Quantity, &mut [f32])> = quantities.into_iter().zip(values).collect();
    let request = ReceiversRequest {
        octree: &octree,
        positions,
        normals,
        skip_empty,
        eye: eye.map(DVec3::from_array),
        settings,
    };
    let report = run(py, progress, |progress, cancel| {
        let take = |index: usize, shading: &Shading| {
            for (quantity, values) in &mut outputs {
                let value = quantity.of(shading);
                match quantity.is_scalar() {
                    true => values[index] = value[0],
                    false => values[3 * index..3 * index + 3].copy_from_slice(&value),
                }
            }
        };
        shade_receivers(&request, take, progress, cancel)
    })?;
    for warning in &report.warnings {
        warn(py, warning)?;
    }
    Ok((results.clone(), crate::json(py, &report)?))
}
