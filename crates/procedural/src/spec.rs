//! The text that names a procedural scene.

/// Names of the scenes.
pub(super) const SCENE_NAMES: [&str; 5] = ["street", "cornell", "spheres", "foliage", "room"];

/// A procedural scene as named by the user: `demo:NAME` or `demo:NAME?key=value&key=value`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ProceduralSpec {
    /// One of `street`, `cornell`, `spheres`, `foliage`, `room`.
    pub name: String,
    /// `seed`: chooses among variants; 1 if not given.
    pub seed: u64,
    /// `surfels`: how many surfels to dice the scene into, such as `2M`.
    pub surfels: Option<u64>,
    /// `size`, 1..=64: houses per side of the street, spheres, or trees. The other scenes ignore
    /// it.
    pub size: Option<u32>,
}

/// Why a text names no procedural scene.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ProceduralError {
    /// It does not start with `demo:`.
    #[error(
        "\"{spec}\" is not a procedural scene; write it as demo:NAME, such as demo:street?seed=1"
    )]
    Prefix {
        /// The whole text.
        spec: String,
    },
    /// A scene that does not exist.
    #[error("there is no procedural scene \"{name}\"; the scenes are {}", SCENE_NAMES.join(", "))]
    Name {
        /// What was asked for.
        name: String,
    },
    /// A key that does not exist.
    #[error("procedural scenes have no key \"{key}\"; the keys are seed, surfels and size")]
    Key {
        /// What was asked for.
        key: String,
    },
    /// A value out of range.
    #[error("{key}={value} is not valid; expected {expected}")]
    Value {
        /// The key.
        key: String,
        /// What was found.
        value: String,
        /// What was expected.
        expected: &'static str,
    },
}

impl ProceduralSpec {
    /// Whether a text means a procedural scene rather than a file.
    #[must_use]
    pub fn matches(text: &str) -> bool {
        text.starts_with("demo:")
    }

    /// Reads a text such as `demo:street?seed=7&surfels=2M`. Counts take the suffixes K, M and G
    /// (thousand, million, thousand million) and may then have decimals.
    ///
    /// # Errors
    ///
    /// [`ProceduralError`], naming what is wrong and what would be right.
    ///
    /// ```
    /// # use pbgi_procedural::ProceduralSpec;
    /// let spec = ProceduralSpec::parse("demo:street?seed=7&surfels=1.5M")?;
    /// assert_eq!((spec.seed, spec.surfels), (7, Some(1_500_000)));
    /// # Ok::<(), pbgi_procedural::ProceduralError>(())
    /// ```
    pub fn parse(text: &str) -> Result<Self, ProceduralError> {
        let Some(rest) = text.strip_prefix("demo:") else {
            return Err(ProceduralError::Prefix { spec: text.to_owned() });
        };
        let (name, query) = rest.split_once('?').unwrap_or((rest, ""));
        if !SCENE_NAMES.contains(&name) {
            return Err(ProceduralError::Name { name: name.to_owned() });
        }
        let mut spec = Self { name: name.to_owned(), seed: 1, surfels: None, size: None };
        for pair in query.split('&').filter(|pair| !pair.is_empty()) {
            let (key, value) = pair.split_once('=').unwrap_or((pair, ""));
            let invalid = |expected| ProceduralError::Value {
                key: key.to_owned(),
                value: value.to_owned(),
                expected,
            };
            match key {
                "seed" => {
                    spec.seed = value.parse().map_err(|_| invalid("a whole number, such as 1"))?;
                }
                "surfels" => {
                    let count = parse_count(value).filter(|count| *count > 0);
                    spec.surfels = Some(count.ok_or_else(|| invalid("a count, such as 2M"))?);
                }
                "size" => {
                    let size = value.parse().ok().filter(|size| (1..=64).contains(size));
                    spec.size = Some(size.ok_or_else(|| invalid("a number from 1 to 64"))?);
                }
                _ => return Err(ProceduralError::Key { key: key.to_owned() }),
            }
        }
        Ok(spec)
    }
}

/// A count with an optional suffix K, M or G.
fn parse_count(text: &str) -> Option<u64> {
    let (digits, factor) = match text.chars().last()? {
        'k' | 'K' => (&text[..text.len() - 1], 1e3),
        'm' | 'M' => (&text[..text.len() - 1], 1e6),
        'g' | 'G' => (&text[..text.len() - 1], 1e9),
        _ => return text.parse().ok(),
    };
    if !digits.bytes().all(|byte| byte.is_ascii_digit() || byte == b'.') {
        return None;
    }
    let count = (digits.parse::<f64>().ok()? * factor).round();
    (count < 1e18).then_some(count as u64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn specs_are_read() {
        let spec = ProceduralSpec::parse("demo:street?seed=3&surfels=20M&size=8").unwrap();
        assert_eq!(spec.name, "street");
        assert_eq!((spec.seed, spec.surfels, spec.size), (3, Some(20_000_000), Some(8)));
        let plain = ProceduralSpec::parse("demo:room").unwrap();
        assert_eq!((plain.seed, plain.surfels, plain.size), (1, None, None));
        assert_eq!(parse_count("250k"), Some(250_000));
        assert_eq!(parse_count("1.25G"), Some(1_250_000_000));
    }

    #[test]
    fn errors_name_the_cure() {
        let message = |text: &str| ProceduralSpec::parse(text).unwrap_err().to_string();
        assert!(message("street").contains("demo:street"));
        assert!(message("demo:moon").contains("cornell"));
        assert!(message("demo:room?blocks=3").contains("seed, surfels and size"));
        for value in ["", "M", "-1", "1e400G", "nan", "é", "0", "9999999999999G"] {
            assert!(message(&format!("demo:room?surfels={value}")).contains("such as 2M"));
        }
        assert!(message("demo:room?size=65").contains("1 to 64"));
        assert!(message("demo:room?seed").contains("whole number"));
    }
}
