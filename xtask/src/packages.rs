//! What the workspace is made of, as `cargo metadata` tells.

use crate::workspace::Workspace;
use serde::Deserialize;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// A package: one of the workspace, or a dependency.
#[derive(Clone, Debug, Deserialize)]
pub struct Package {
    id: String,
    pub name: String,
    pub version: String,
    /// Its license as an SPDX expression.
    pub license: Option<String>,
    pub description: Option<String>,
    pub authors: Vec<String>,
    /// Where it comes from; nothing for packages of a workspace.
    pub source: Option<String>,
    /// Registries it may be published to; nothing for any.
    pub publish: Option<Vec<String>>,
    pub dependencies: Vec<Dependency>,
    manifest_path: PathBuf,
}

/// A line of a manifest.
#[derive(Clone, Debug, Deserialize)]
pub struct Dependency {
    pub name: String,
    /// The versions that will do.
    pub req: String,
    /// `dev` or `build`; nothing for others.
    pub kind: Option<String>,
    /// Where it lies, if it is part of a workspace.
    pub path: Option<PathBuf>,
}

impl Package {
    /// The folder of its manifest.
    pub fn folder(&self) -> &Path {
        self.manifest_path.parent().unwrap_or(Path::new("."))
    }

    /// Whether it may be published.
    pub fn is_published(&self) -> bool {
        self.source.is_none() && self.publish.as_ref().is_none_or(|to| !to.is_empty())
    }
}

/// All packages, and which of them use which.
pub struct Packages {
    packages: Vec<Package>,
    /// Ids of the packages that are linked or run to compile, by the id of their user; those of tests are left out.
    uses: BTreeMap<String, Vec<String>>,
}

#[derive(Deserialize)]
struct Metadata {
    packages: Vec<Package>,
    resolve: Resolve,
}

#[derive(Deserialize)]
struct Resolve {
    nodes: Vec<Node>,
}

#[derive(Deserialize)]
struct Node {
    id: String,
    deps: Vec<Used>,
}

#[derive(Deserialize)]
struct Used {
    pkg: String,
    dep_kinds: Vec<UsedAs>,
}

#[derive(Deserialize)]
struct UsedAs {
    kind: Option<String>,
}

impl Packages {
    /// Those of the manifest `manifest` (relative to the root) for one target, or for all.
    pub fn read(
        workspace: &Workspace,
        manifest: &str,
        target: Option<&str>,
    ) -> Result<Self, String> {
        let mut command = workspace.cargo();
        command.args([
            "metadata",
            "--format-version",
            "1",
            "--locked",
            "--manifest-path",
            manifest,
        ]);
        command.args(target.map(|target| format!("--filter-platform={target}")));
        let output = command.output().map_err(|e| format!("cargo metadata: {e}"))?;
        if !output.status.success() {
            let said = String::from_utf8_lossy(&output.stderr).into_owned();
            return Err(format!("cargo metadata of {manifest}: {said}"));
        }
        let metadata: Metadata = serde_json::from_slice(&output.stdout)
            .map_err(|e| format!("cargo metadata of {manifest}: {e}"))?;
        let linked = |used: &Used| used.dep_kinds.iter().any(|used| used.kind.is_none());
        let uses = metadata.resolve.nodes.into_iter().map(|node| {
            let used = node.deps.into_iter().filter(linked).map(|used| used.pkg);
            (node.id, used.collect())
        });
        Ok(Self { packages: metadata.packages, uses: uses.collect() })
    }

    /// All of them.
    pub fn all(&self) -> &[Package] {
        &self.packages
    }

    /// The package `name` and all it is linked with, by name and version.
    pub fn linked_into(&self, name: &str) -> Result<Vec<&Package>, String> {
        let root = self.packages.iter().find(|package| package.name == name);
        let root = root.ok_or_else(|| format!("there is no package {name}"))?;
        let (mut found, mut open) = (BTreeSet::new(), vec![&root.id]);
        while let Some(id) = open.pop() {
            if found.insert(id) {
                open.extend(self.uses.get(id).into_iter().flatten());
            }
        }
        let mut linked: Vec<&Package> =
            self.packages.iter().filter(|package| found.contains(&package.id)).collect();
        linked.sort_by(|a, b| (&a.name, &a.version).cmp(&(&b.name, &b.version)));
        Ok(linked)
    }
}
