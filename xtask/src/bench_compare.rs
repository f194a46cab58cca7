//! Two runs of the bench `truth` on record, one over the other.

use std::collections::BTreeMap;
use std::path::Path;

/// What was measured: scene, quantity, setting.
type Key = [String; 3];

/// Core-microseconds per receiver, and rRMSE.
type Measured = [f64; 2];

/// Prints, for every setting that both files have, the times and errors of the new one over those of the old, and the geometric means by scene.
pub fn run(old: &str, new: &str) -> Result<(), String> {
    let (old, new) = (read(Path::new(old))?, read(Path::new(new))?);
    print!("{}", compared(&old, &new)?);
    Ok(())
}

fn read(path: &Path) -> Result<BTreeMap<Key, Measured>, String> {
    let text = std::fs::read_to_string(path).map_err(|e| format!("{}: {e}", path.display()))?;
    parse(&text).map_err(|e| format!("{}: {e}", path.display()))
}

/// The rows of a record.
fn parse(text: &str) -> Result<BTreeMap<Key, Measured>, String> {
    let mut rows = BTreeMap::new();
    for (number, line) in text.lines().enumerate().skip(1) {
        let fields: Vec<&str> = line.split(',').collect();
        let row = match fields[..] {
            [scene, quantity, setting, us, error] => us
                .parse()
                .ok()
                .zip(error.parse().ok())
                .map(|(us, error)| ([scene, quantity, setting].map(str::to_owned), [us, error])),
            _ => None,
        };
        let Some((key, measured)) = row else {
            return Err(format!(
                "line {}: expected scene,quantity,setting,core_us_per_receiver,rrmse, as `cargo xtask truth --record` writes it",
                number + 1
            ));
        };
        rows.insert(key, measured);
    }
    Ok(rows)
}

/// Ratios, new over old.
fn compared(
    old: &BTreeMap<Key, Measured>,
    new: &BTreeMap<Key, Measured>,
) -> Result<String, String> {
    let mut out = format!("{:64} {:>8} {:>8}\n", "new over old", "time", "error");
    // Sums of logarithms, and how many, by scene and of all.
    let mut means: BTreeMap<&str, ([f64; 2], usize)> = BTreeMap::new();
    for (key, [old_us, old_error]) in old {
        let Some([us, error]) = new.get(key) else { continue };
        let ratios = [us / old_us, error.max(1e-4) / old_error.max(1e-4)];
        let label = key.join(" ");
        out += &format!("{label:64} {:8.2} {:8.2}\n", ratios[0], ratios[1]);
        for name in [key[0].as_str(), "all"] {
            let (sums, count) = means.entry(name).or_default();
            sums.iter_mut().zip(ratios).for_each(|(sum, ratio)| *sum += ratio.ln());
            *count += 1;
        }
    }
    if means.is_empty() {
        return Err("the two records have no setting in common".to_owned());
    }
    for (name, (sums, count)) in means {
        let [time, error] = sums.map(|sum| (sum / count as f64).exp());
        let label = format!("geometric mean of {name} ({count})");
        out += &format!("{label:64} {time:8.2} {error:8.2}\n");
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ratios_are_of_what_both_have() {
        let header = "scene,quantity,setting,core_us_per_receiver,rrmse\n";
        let old =
            parse(&format!("{header}a,light,fine,100,0.02\na,light,coarse,10,0.1\n")).unwrap();
        let new = parse(&format!("{header}a,light,fine,50,0.04\nb,light,fine,1,1\n")).unwrap();
        let text = compared(&old, &new).unwrap();
        let line = text.lines().find(|line| line.starts_with("a light fine")).unwrap();
        assert!(line.ends_with("    0.50     2.00"), "{line}");
        assert!(!text.contains("coarse") && !text.contains("b light"), "{text}");
        assert!(text.contains("geometric mean of all (1)"), "{text}");
        assert!(compared(&old, &BTreeMap::new()).unwrap_err().contains("no setting in common"));
        assert!(parse(&format!("{header}a,light,fine,1\n")).unwrap_err().contains("line 2"));
        assert!(parse(&format!("{header}a,light,fine,one,2\n")).unwrap_err().contains("line 2"));
    }
}
