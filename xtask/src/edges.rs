//! Which crate may use which: one list, checked against manifests, sources and ARCHITECTURE.md.

use crate::workspace::Workspace;

/// Every crate in `crates/` with the workspace crates it uses, in the order of the layers.
pub const EDGES: [(&str, &[&str]); 20] = [
    ("math", &[]),
    ("file", &[]),
    ("cloud", &["file", "math"]),
    ("image", &["file", "math"]),
    ("format", &["math"]),
    ("raster", &["math"]),
    ("scene", &["cloud", "math"]),
    ("mesh", &["cloud", "file", "math", "scene"]),
    ("procedural", &["math", "scene"]),
    ("light", &["image", "math"]),
    ("sort", &["cloud", "file", "math"]),
    ("build", &["cloud", "file", "format", "math"]),
    ("store", &["file", "format", "math"]),
    ("cut", &["format", "math", "store"]),
    ("brdf", &["math", "raster"]),
    ("gather", &["brdf", "cut", "format", "light", "math", "raster", "store"]),
    ("schedule", &["gather", "math", "store"]),
    ("bounce", &["cloud", "gather", "math", "schedule", "store"]),
    (
        "pbgi",
        &[
            "bounce",
            "build",
            "cloud",
            "file",
            "format",
            "gather",
            "image",
            "light",
            "math",
            "mesh",
            "procedural",
            "scene",
            "schedule",
            "sort",
            "store",
        ],
    ),
    ("testkit", &["cloud", "math"]),
];

/// The only crate that may be a dev-dependency without being in the list.
const TESTKIT: &str = "testkit";

/// The list as ARCHITECTURE.md shows it.
pub fn render() -> String {
    let mut out = String::new();
    for (name, uses) in EDGES {
        let uses = if uses.is_empty() { "nothing".to_owned() } else { uses.join(", ") };
        out.push_str(&format!("{name:<10} -> {uses}\n"));
    }
    out.push_str("tools      -> pbgi\n");
    out
}

/// What is wrong with the edges between crates.
pub fn check(workspace: &Workspace) -> Result<Vec<String>, String> {
    let mut faults = Vec::new();
    let files = workspace.files()?;
    for name in workspace.crates()? {
        let Some((_, allowed)) = EDGES.iter().find(|(listed, _)| *listed == name) else {
            faults.push(format!("crates/{name}: not in the list of xtask/src/edges.rs"));
            continue;
        };
        let manifest = workspace.read(&format!("crates/{name}/Cargo.toml"))?;
        let sources = Workspace::sources(&files, &format!("crates/{name}/"));
        let code: Result<Vec<String>, String> =
            sources.iter().map(|path| workspace.read(path)).collect();
        faults.extend(check_crate(&name, allowed, &manifest, &code?.concat()));
    }
    for (name, _) in EDGES {
        if !workspace.root().join("crates").join(name).is_dir() {
            faults.push(format!("xtask/src/edges.rs: there is no crate {name}"));
        }
    }
    faults.extend(check_tools(workspace, &files)?);
    let block = format!("```text\n{}```", render());
    if !workspace.read("ARCHITECTURE.md")?.contains(&block) {
        faults.push(format!(
            "ARCHITECTURE.md: its list of edges is not that of xtask/src/edges.rs, which is\n{block}"
        ));
    }
    Ok(faults)
}

fn check_crate(name: &str, allowed: &[&str], manifest: &str, code: &str) -> Vec<String> {
    let mut faults = Vec::new();
    let place = format!("crates/{name}/Cargo.toml");
    let used = dependencies(manifest, "dependencies");
    for dependency in &used {
        if !allowed.contains(&dependency.as_str()) {
            faults.push(format!("{place}: {name} must not use {dependency}"));
        } else if !code.contains(&crate_path(dependency)) {
            faults.push(format!("{place}: {dependency} is not used by any source"));
        }
    }
    for dependency in allowed {
        if !used.iter().any(|u| u == dependency) {
            faults.push(format!("xtask/src/edges.rs: {name} does not use {dependency}"));
        }
    }
    for dependency in dependencies(manifest, "dev-dependencies") {
        if dependency != TESTKIT && !allowed.contains(&dependency.as_str()) {
            faults.push(format!("{place}: tests of {name} must not use {dependency}"));
        }
    }
    faults
}

/// The package of the tools' commands.
const COMMANDS: &str = "tools/pbgi-cli/Cargo.toml";

/// Commands go through the facade only, and programs of one command through the commands.
fn check_tools(workspace: &Workspace, files: &[String]) -> Result<Vec<String>, String> {
    let mut faults = Vec::new();
    for path in files.iter().filter(|p| p.starts_with("tools/") && p.ends_with("/Cargo.toml")) {
        let (allowed, shown) =
            if path == COMMANDS { ("pbgi", "pbgi") } else { ("cli", "pbgi-cli") };
        for dependency in dependencies(&workspace.read(path)?, "dependencies") {
            if dependency != allowed {
                faults
                    .push(format!("{path}: a tool like this uses {shown} only, not {dependency}"));
            }
        }
    }
    Ok(faults)
}

/// Name of a crate in code: `pbgi_math`, or `pbgi` itself.
fn crate_path(name: &str) -> String {
    if name == "pbgi" { name.to_owned() } else { format!("pbgi_{name}") }
}

/// Workspace crates a section of a manifest names, without their `pbgi-`.
fn dependencies(manifest: &str, section: &str) -> Vec<String> {
    let heading = format!("[{section}]");
    let mut names = Vec::new();
    let mut inside = false;
    for line in manifest.lines().map(str::trim) {
        if line.starts_with('[') {
            inside = line == heading;
            continue;
        }
        let Some(name) = line.split(['.', '=', ' ']).next().filter(|_| inside) else { continue };
        if name == "pbgi" {
            names.push(name.to_owned());
        } else if let Some(short) = name.strip_prefix("pbgi-") {
            names.push(short.to_owned());
        }
    }
    names
}

#[cfg(test)]
mod tests {
    use super::*;

    const MANIFEST: &str = "[package]\nname = \"pbgi-x\"\n[dependencies]\npbgi-math.workspace = true\n\
        glam = \"1\"\npbgi-cloud = { workspace = true }\n[dev-dependencies]\npbgi-testkit.workspace = true\n";

    #[test]
    fn sections_of_manifests_are_told_apart() {
        assert_eq!(dependencies(MANIFEST, "dependencies"), ["math", "cloud"]);
        assert_eq!(dependencies(MANIFEST, "dev-dependencies"), ["testkit"]);
    }

    #[test]
    fn unlisted_unused_and_missing_edges_are_each_reported() {
        let code = "use pbgi_math::Vec3; use pbgi_cloud::Surfel;";
        assert!(check_crate("x", &["cloud", "math"], MANIFEST, code).is_empty());
        let faults = |allowed: &[&str], code| check_crate("x", allowed, MANIFEST, code);
        assert!(faults(&["math"], code)[0].contains("must not use cloud"));
        assert!(faults(&["cloud", "math"], "use pbgi_math::Vec3;")[0].contains("not used"));
        assert!(faults(&["cloud", "math", "store"], code)[0].contains("does not use store"));
    }

    #[test]
    fn the_list_has_no_cycle() {
        for (i, (name, uses)) in EDGES.iter().enumerate() {
            for dependency in *uses {
                let place = EDGES.iter().position(|(listed, _)| listed == dependency);
                assert!(place.is_some_and(|p| p < i), "{name} -> {dependency}");
            }
        }
    }
}
