//! Registries from which images are pulled. The engine connects to them with its own rights, and so reaches ports of the
//! machine that a VNF does not.

use std::env;

/// Variable with the hosts of further registries, separated by commas.
const VARIABLE: &str = "COTORRA_REGISTRIES";
/// Registries that need no permission.
const USUAL: &[&str] = &[
    "docker.io",
    "gcr.io",
    "ghcr.io",
    "mcr.microsoft.com",
    "nvcr.io",
    "public.ecr.aws",
    "quay.io",
    "registry.gitlab.com",
    "registry.k8s.io",
];

/// The registries from which a run or an agent pulls images.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct Registries {
    further: Vec<String>,
}

impl Registries {
    /// Returns the usual ones, and those that the variable `COTORRA_REGISTRIES` of this process names.
    pub(crate) fn from_environment() -> Self {
        Self::with(&env::var(VARIABLE).unwrap_or_default())
    }

    fn with(further: &str) -> Self {
        let hosts = further.split(',').map(str::trim).filter(|host| !host.is_empty());
        Self { further: hosts.map(str::to_owned).collect() }
    }

    /// Checks that an image may be pulled.
    ///
    /// # Errors
    /// The reason, for people.
    pub(crate) fn check(&self, reference: &str) -> Result<(), String> {
        let Some(host) = host(reference) else {
            return Err(format!(
                "it is not on this machine, and has no registry in its name: write it with its registry, such as `docker.io/library/{reference}`, to \
                 pull it from Docker Hub, or build it here"
            ));
        };
        if USUAL.contains(&host) || self.further.iter().any(|further| further == host) {
            return Ok(());
        }
        Err(format!(
            "images of the registry `{host}` are not pulled: pull it yourself, or start cotorra with {VARIABLE}={host}"
        ))
    }
}

/// Returns the host of an image's registry, with its port. Names without one, and those of `localhost`, are images of this
/// machine.
fn host(reference: &str) -> Option<&str> {
    let (first, _) = reference.split_once('/')?;
    (first.contains(['.', ':'])).then_some(first)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_usual_and_named_registries_are_reached() {
        let registries = Registries::with("registry.lab:5000, 10.0.0.7");
        for allowed in [
            "docker.io/library/ros:jazzy",
            "ghcr.io/lab/planner@sha256:00ff",
            "registry.lab:5000/planner",
            "10.0.0.7/planner:1",
        ] {
            assert_eq!(registries.check(allowed), Ok(()), "{allowed}");
        }
        for (rejected, advice) in [
            ("127.0.0.1:5000/x", "COTORRA_REGISTRIES=127.0.0.1:5000"),
            ("[::1]:5000/x", "COTORRA_REGISTRIES=[::1]:5000"),
            ("localhost:22/x", "COTORRA_REGISTRIES=localhost:22"),
            ("registry.lab/x", "COTORRA_REGISTRIES=registry.lab"),
            ("evil.example/docker.io/x", "COTORRA_REGISTRIES=evil.example"),
            ("localhost/x", "docker.io/library/localhost/x"),
            ("ros:jazzy", "docker.io/library/ros:jazzy"),
            ("lab/x", "docker.io/library/lab/x"),
        ] {
            let reason = registries.check(rejected).unwrap_err();
            assert!(reason.contains(advice), "{reason}");
        }
    }
}
