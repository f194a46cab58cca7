//! Licenses: whether those of all dependencies are allowed, and their texts for what is given away.

use crate::packages::{Package, Packages};
use crate::spdx;
use crate::workspace::Workspace;
use std::collections::BTreeMap;
use std::fs;

/// Workspaces with dependencies of their own.
const MANIFESTS: [&str; 2] = ["Cargo.toml", "python/Cargo.toml"];

/// How files with the text of a license begin, in capitals.
const TEXT_NAMES: [&str; 6] = ["LICENSE", "LICENCE", "COPYING", "COPYRIGHT", "UNLICENSE", "NOTICE"];

/// Checks the license of every dependency, those of tests included, against the list in `deny.toml`; and that all come from a registry.
pub fn check(workspace: &Workspace) -> Result<(), String> {
    let allowed = allowed_in(&workspace.read("deny.toml")?)?;
    let (mut faults, mut count) = (Vec::new(), 0);
    for manifest in MANIFESTS {
        let packages = Packages::read(workspace, manifest, None)?;
        count += packages.all().len();
        faults.extend(packages.all().iter().filter_map(|package| fault_of(package, &allowed)));
    }
    faults.sort();
    faults.dedup();
    if !faults.is_empty() {
        return Err(format!("{}\nlicenses: {} to mend", faults.join("\n"), faults.len()));
    }
    println!("licenses: those of {count} packages are allowed");
    Ok(())
}

/// What is wrong with a package.
fn fault_of(package: &Package, allowed: &[String]) -> Option<String> {
    let Package { name, version, license, source, .. } = package;
    if source.as_ref().is_some_and(|source| !source.starts_with("registry+")) {
        return Some(format!("{name} {version}: comes from no registry"));
    }
    let Some(license) = license else { return Some(format!("{name} {version}: has no license")) };
    let is_allowed = |license: &str| allowed.iter().any(|allowed| allowed == license);
    match spdx::is_met(license, &is_allowed) {
        Ok(true) => None,
        Ok(false) => Some(format!("{name} {version}: {license} is not in the list of deny.toml")),
        Err(error) => Some(format!("{name} {version}: {error}")),
    }
}

/// The list `allow` of the section `licenses`.
fn allowed_in(deny: &str) -> Result<Vec<String>, String> {
    let list = deny
        .split_once("\n[licenses]\n")
        .and_then(|(_, section)| section.split("\n[").next()?.split_once("\nallow = ["))
        .and_then(|(_, list)| Some(list.split_once(']')?.0))
        .ok_or("deny.toml: there is no list `allow` in [licenses]")?;
    Ok(list.split('"').skip(1).step_by(2).map(str::to_owned).collect())
}

/// The texts of the licenses of `packages` that are not of this workspace, each once, with those it belongs to.
///
/// A package whose author left the text out gets the usual one of a license it may be used under.
pub fn texts_of(workspace: &Workspace, packages: &[&Package]) -> Result<String, String> {
    let mut texts: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for package in packages.iter().filter(|package| package.source.is_some()) {
        let license = package.license.as_deref().unwrap_or("no license");
        let label = format!("{} {} ({license})", package.name, package.version);
        for text in own_texts(package)?.map_or_else(|| usual_text(workspace, package), Ok)? {
            texts.entry(text).or_default().push(label.clone());
        }
    }
    let mut sections: Vec<(Vec<String>, String)> =
        texts.into_iter().map(|(text, labels)| (labels, text)).collect();
    sections.sort();
    let mut out = "Licenses of what this program is made of beside its own sources.\n".to_owned();
    for (labels, text) in sections {
        let rule = "-".repeat(80);
        out.push_str(&format!("\n{rule}\n{}\n{rule}\n\n{text}\n", labels.join("\n")));
    }
    Ok(out)
}

/// The texts that lie beside the manifest, none if there are none.
fn own_texts(package: &Package) -> Result<Option<Vec<String>>, String> {
    let folder = package.folder();
    let fault = |e| format!("{}: {e}", folder.display());
    let mut texts = Vec::new();
    for entry in fs::read_dir(folder).map_err(fault)? {
        let entry = entry.map_err(fault)?;
        let name = entry.file_name().to_string_lossy().to_uppercase();
        if TEXT_NAMES.iter().any(|start| name.starts_with(start)) && entry.path().is_file() {
            let bytes = fs::read(entry.path()).map_err(fault)?;
            let text = String::from_utf8_lossy(&bytes).replace("\r\n", "\n");
            texts.push(text.trim_end().to_owned());
        }
    }
    texts.sort();
    Ok((!texts.is_empty()).then_some(texts))
}

/// The text of MIT with the names of the authors, or that of Apache 2.0, which names nobody.
fn usual_text(workspace: &Workspace, package: &Package) -> Result<Vec<String>, String> {
    let license = package.license.as_deref().unwrap_or_default();
    let may = |wanted: &str| spdx::is_met(license, &|name| name == wanted).unwrap_or(false);
    if may("MIT") {
        let text = workspace.read("LICENSE-MIT")?;
        let authors = match package.authors.join(", ") {
            authors if authors.is_empty() => format!("the authors of {}", package.name),
            authors => authors,
        };
        let lines = text.trim_end().lines().map(|line| match line.starts_with("Copyright") {
            true => format!("Copyright (c) {authors}"),
            false => line.to_owned(),
        });
        return Ok(vec![lines.collect::<Vec<_>>().join("\n")]);
    }
    if may("Apache-2.0") {
        return Ok(vec![workspace.read("LICENSE-APACHE")?.trim_end().to_owned()]);
    }
    let Package { name, version, .. } = package;
    Err(format!("{name} {version}: there is no text of its license, {license}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_list_of_licenses_is_read() {
        let text = "# x\n\n[licenses]\nversion = 2\nallow = [\n    \"MIT\",\n    \"A WITH B\",\n]\n\n[bans]\nx = [\"GPL\"]\n";
        assert_eq!(allowed_in(text).unwrap(), ["MIT", "A WITH B"]);
        assert!(allowed_in("[bans]\nallow = [\"MIT\"]\n").is_err());
        assert!(allowed_in("\n[licenses]\nversion = 2\n\n[bans]\nallow = [\"MIT\"]\n").is_err());
    }

    #[test]
    fn packages_need_an_allowed_license_and_a_registry() {
        let packages = Packages::read(&Workspace::find().unwrap(), "Cargo.toml", None).unwrap();
        let find = |name: &str| packages.all().iter().find(|p| p.name == name).unwrap().clone();
        let allowed = ["MIT".to_owned()];
        let of = |change: &dyn Fn(&mut Package)| {
            let mut package = find("clap");
            change(&mut package);
            fault_of(&package, &allowed)
        };
        assert_eq!(of(&|_| ()), None);
        assert!(of(&|p| p.license = None).unwrap().contains("has no license"));
        assert!(of(&|p| p.license = Some("GPL-3.0".into())).unwrap().contains("GPL-3.0 is not"));
        assert!(of(&|p| p.source = Some("git+x".into())).unwrap().contains("no registry"));
    }

    #[test]
    fn texts_name_whose_they_are() {
        let workspace = Workspace::find().unwrap();
        let packages = Packages::read(&workspace, "Cargo.toml", None).unwrap();
        let text = texts_of(&workspace, &packages.linked_into("pbgi-cli").unwrap()).unwrap();
        for expected in ["exr 1.", "(BSD-3-Clause)", "Boost Software License", "unicode-ident"] {
            assert!(text.contains(expected), "{expected}");
        }
        // Not linked: a dependency of tests, and the workspace itself.
        assert!(!text.contains("\nshuttle ") && !text.contains("\npbgi-math "));
        // Its author left the text out.
        let mut package = packages.all().iter().find(|p| p.name == "zune-inflate").unwrap().clone();
        assert_eq!(own_texts(&package).unwrap(), None);
        assert!(usual_text(&workspace, &package).unwrap()[0].contains("zune-inflate"));
        package.license = Some("Zlib".into());
        assert!(usual_text(&workspace, &package).is_err());
    }
}
