//! The one file that an agent needs: the core's address, and credentials.

use std::{collections::HashMap, fmt, io, path::Path};

use crate::{AgentCertificate, CoreEndpoint, certificates::Credentials, files, time_text};

/// Longest text of a bundle in bytes. A usual one has 2000.
const LONGEST: usize = 64 << 10;
const KEYS: [&str; 7] = ["agent", "generation", "expires", "core", "authority", "certificate", "key"];

/// Credentials of an agent: the core's address, the authority's certificate, and its own certificate and key.
///
/// The text of a bundle has lines `key: value` and blocks of PEM. All that is read has been checked: the authority signed
/// the certificate, the key is that of the certificate, and the lines say what the certificate says.
pub struct Bundle {
    core: CoreEndpoint,
    authority_pem: String,
    credentials: Credentials,
    certificate: AgentCertificate,
}

/// Error of a text that is not a bundle.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum BundleError {
    /// The text is too long.
    #[error("it has {bytes} bytes; a bundle has at most {LONGEST}")]
    TooLong {
        /// Its length.
        bytes: usize,
    },
    /// A line that is none of a bundle.
    #[error("line {line}: {problem}")]
    Line {
        /// Number of the line, from 1.
        line: usize,
        /// The mistake, and its correction.
        problem: String,
    },
    /// A key that every bundle has.
    #[error("it has no `{key}`; it may be cut off")]
    Missing {
        /// The key.
        key: &'static str,
    },
    /// Credentials that do not belong together.
    #[error("{problem}; it may be made of several files")]
    Credentials {
        /// The mistake.
        problem: String,
    },
}

impl Bundle {
    /// Puts credentials together that the authority just made.
    pub(crate) fn new(
        core: CoreEndpoint,
        authority_pem: String,
        credentials: Credentials,
        certificate: AgentCertificate,
    ) -> Self {
        Self { core, authority_pem, credentials, certificate }
    }

    /// Reads the text of a bundle. An expired one is read, too.
    ///
    /// # Errors
    /// [`BundleError`] if the text is not what [`Bundle::text`] returned.
    pub fn parse(text: &str) -> Result<Self, BundleError> {
        if text.len() > LONGEST {
            return Err(BundleError::TooLong { bytes: text.len() });
        }
        let mut entries = entries(text)?;
        if let Some(key) = KEYS.into_iter().find(|key| !entries.contains_key(key)) {
            return Err(BundleError::Missing { key });
        }
        let [
            agent,
            generation,
            expires,
            (line, core),
            (_, authority_pem),
            (_, certificate_pem),
            (_, key_pem),
        ] = KEYS.map(|key| entries.remove(key).expect("every key is there"));
        let credentials = Credentials { certificate_pem, key_pem };
        let core = core
            .parse::<CoreEndpoint>()
            .map_err(|error| BundleError::Line { line, problem: error.to_string() })?;
        let certificate =
            credentials.agent(&authority_pem).map_err(|problem| BundleError::Credentials { problem })?;
        for ((line, said), is) in [
            (agent, certificate.name.to_string()),
            (generation, certificate.generation.to_string()),
            (expires, time_text::format(certificate.not_after)),
        ] {
            if said != is {
                let problem = format!("it says `{said}`, and the certificate `{is}`");
                return Err(BundleError::Line { line, problem });
            }
        }
        Ok(Self { core, authority_pem, credentials, certificate })
    }

    /// Returns the text, which has the key: whoever reads it can act as the agent.
    pub fn text(&self) -> String {
        let Self { core, authority_pem, credentials, certificate } = self;
        let AgentCertificate { name, generation, not_after } = certificate;
        let Credentials { certificate_pem, key_pem } = credentials;
        let expires = time_text::format(*not_after);
        format!(
            "# Credentials of a cotorra agent. Keep this file secret: whoever has it can act as the agent.\n\
             agent: {name}\ngeneration: {generation}\nexpires: {expires}\ncore: {core}\n\n\
             authority:\n{authority_pem}\ncertificate:\n{certificate_pem}\nkey:\n{key_pem}"
        )
    }

    /// Writes the text to a file that only its user can read, in place of what is there. A reader sees the old file or the
    /// new one, also after a crash.
    ///
    /// # Errors
    /// The system's error.
    pub fn write(&self, path: &Path) -> io::Result<()> {
        files::write(path, &self.text())
    }

    /// The address at which the agent reaches the core.
    pub fn core(&self) -> &CoreEndpoint {
        &self.core
    }

    /// Content of the agent's certificate.
    pub fn certificate(&self) -> &AgentCertificate {
        &self.certificate
    }

    /// The authority's certificate, by which the agent knows the core.
    pub fn authority_pem(&self) -> &str {
        &self.authority_pem
    }

    /// The agent's certificate.
    pub fn certificate_pem(&self) -> &str {
        &self.credentials.certificate_pem
    }

    /// The agent's key, which is secret.
    pub fn key_pem(&self) -> &str {
        &self.credentials.key_pem
    }
}

/// Leaves the key out.
impl fmt::Debug for Bundle {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { core, certificate, .. } = self;
        f.debug_struct("Bundle").field("core", core).field("certificate", certificate).finish_non_exhaustive()
    }
}

/// Returns the values of a text with their lines, by key. A value is the rest of its line, or the block of PEM after it.
fn entries(text: &str) -> Result<HashMap<&str, (usize, String)>, BundleError> {
    let mut entries = HashMap::new();
    let mut lines = (1..).zip(text.lines());
    while let Some((line, content)) = lines.next() {
        let wrong = |problem: String| BundleError::Line { line, problem };
        if content.trim().is_empty() || content.starts_with('#') {
            continue;
        }
        let entry = content.split_once(':').filter(|(key, _)| KEYS.contains(key));
        let (key, value) =
            entry.ok_or_else(|| wrong(format!("a bundle has the keys {}, and blocks", KEYS.join(", "))))?;
        let mut value = value.trim().to_owned();
        if value.is_empty() {
            let mut is_whole = false;
            for (_, content) in lines.by_ref() {
                value.push_str(content.trim_end());
                value.push('\n');
                is_whole = content.starts_with("-----END ");
                if is_whole {
                    break;
                }
            }
            if !is_whole {
                return Err(wrong(format!("the block of `{key}` has no end; the file may be cut off")));
            }
        }
        if entries.insert(key, (line, value)).is_some() {
            return Err(wrong(format!("`{key}` is there twice; leave one out")));
        }
    }
    Ok(entries)
}
