//! Whether the crates can be published: what their manifests must say, and that they pack.

use crate::packages::{Package, Packages};
use crate::workspace::Workspace;

/// Checks the manifests of all crates that are published, and packs each without compiling it.
pub fn check(workspace: &Workspace) -> Result<(), String> {
    let packages = Packages::read(workspace, "Cargo.toml", None)?;
    let published: Vec<&Package> =
        packages.all().iter().filter(|package| package.is_published()).collect();
    let faults: Vec<String> =
        published.iter().flat_map(|package| faults_of(package, &published)).collect();
    if !faults.is_empty() {
        return Err(format!("{}\npublish: {} to mend", faults.join("\n"), faults.len()));
    }
    let mut package = workspace.cargo();
    package.args(["package", "--quiet", "--no-verify", "--allow-dirty", "--locked"]);
    package.args(published.iter().flat_map(|package| ["--package", &package.name]));
    let status = package.status().map_err(|e| format!("cargo package: {e}"))?;
    if !status.success() {
        return Err(format!("cargo package failed: {status}"));
    }
    println!("publish: {} crates pack", published.len());
    Ok(())
}

/// What the manifest of a package lacks. What it uses of the workspace must be published, too, in a stated version; dependencies of tests
/// may be left out when it is packed.
fn faults_of(package: &Package, published: &[&Package]) -> Vec<String> {
    let Package { name, license, description, dependencies, .. } = package;
    let mut faults = Vec::new();
    if license.is_none() {
        faults.push(format!("{name}: has no license"));
    }
    if description.as_ref().is_none_or(|text| text.is_empty()) {
        faults.push(format!("{name}: has no description"));
    }
    for used in dependencies.iter().filter(|used| used.path.is_some()) {
        let is_of_tests = used.kind.as_deref() == Some("dev");
        let has_version = used.req != "*";
        if !has_version && !is_of_tests {
            faults.push(format!("{name}: uses {} without a version", used.name));
        }
        let is_published = published.iter().any(|package| package.name == used.name);
        if !is_published && (has_version || !is_of_tests) {
            faults.push(format!("{name}: uses {}, which is not published", used.name));
        }
    }
    faults
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn crates_have_what_publishing_needs() {
        let packages = Packages::read(&Workspace::find().unwrap(), "Cargo.toml", None).unwrap();
        let published: Vec<&Package> = packages.all().iter().filter(|p| p.is_published()).collect();
        let named = |name: &str| published.iter().any(|package| package.name == name);
        assert!(named("pbgi") && named("pbgi-cli") && !named("xtask") && !named("pbgi-testkit"));
        let pbgi = (*published.iter().find(|package| package.name == "pbgi").unwrap()).clone();
        let faults = |change: &dyn Fn(&mut Package)| {
            let mut package = pbgi.clone();
            change(&mut package);
            faults_of(&package, &published).join(", ")
        };
        assert_eq!(faults(&|_| ()), "");
        assert_eq!(faults(&|p| p.description = None), "pbgi: has no description");
        assert_eq!(faults(&|p| p.license = None), "pbgi: has no license");
        let change = |package: &mut Package, change: &dyn Fn(&mut crate::packages::Dependency)| {
            let own = package.dependencies.iter_mut().find(|used| used.name == "pbgi-math");
            change(own.unwrap());
        };
        let found = faults(&|p| change(p, &|used| used.req = "*".into()));
        assert_eq!(found, "pbgi: uses pbgi-math without a version");
        let found = faults(&|p| change(p, &|used| used.name = "pbgi-testkit".into()));
        assert_eq!(found, "pbgi: uses pbgi-testkit, which is not published");
    }
}
