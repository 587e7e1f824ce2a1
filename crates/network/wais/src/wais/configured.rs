//! Measurement configurations: measurements whose reports are included in station information.

use std::sync::Arc;

use cotorra_graph::Timestamp;
use cotorra_mec::{MOST, RequestError, Resource, check_unchanged, etag};

use super::Wais;
use crate::{
    requests::{InvalidRequest, MeasurementConfig, MeasurementConfigLink, MeasurementConfigLinkList},
    types::SelfLink,
};

#[derive(Debug)]
pub(super) struct Configured {
    pub(super) config: MeasurementConfig,
    version: u64,
}

impl Wais {
    /// Creates a measurement configuration.
    ///
    /// # Errors
    /// [`RequestError`]; then there is none.
    pub fn configure(
        &mut self,
        now: Timestamp,
        base: &str,
        config: MeasurementConfig,
    ) -> Result<Resource<MeasurementConfig>, RequestError> {
        self.subscriptions.admit(now)?;
        self.check_config(None, &config)?;
        if self.configured.len() >= MOST {
            return Err(RequestError::Full);
        }
        let (id, version) = (self.subscriptions.number(), self.subscriptions.number());
        self.configured.insert(id, Configured { config, version });
        self.listings.forget_stations();
        self.measurement(base, &id.to_string())
    }

    /// Replaces a measurement configuration.
    ///
    /// # Errors
    /// [`RequestError`]; then nothing has changed.
    pub fn reconfigure(
        &mut self,
        now: Timestamp,
        base: &str,
        id: &str,
        if_match: Option<&str>,
        config: MeasurementConfig,
    ) -> Result<Resource<MeasurementConfig>, RequestError> {
        self.subscriptions.admit(now)?;
        let (number, configured) = self.find_config(id)?;
        let version = configured.version;
        self.check_config(Some(number), &config)?;
        check_unchanged(if_match, number, version)?;
        let version = self.subscriptions.number();
        self.configured.insert(number, Configured { config, version });
        self.listings.forget_stations();
        self.measurement(base, id)
    }

    fn check_config(&self, own: Option<u64>, config: &MeasurementConfig) -> Result<(), RequestError> {
        config.check()?;
        let same = |(id, other): (&u64, &Configured)| {
            Some(*id) != own && other.config.measurement_id == config.measurement_id
        };
        if self.configured.iter().any(same) {
            let what = format!("another configuration is called `{}`", config.measurement_id);
            return Err(InvalidRequest::Malformed(what).into());
        }
        Ok(())
    }

    fn find_config(&self, id: &str) -> Result<(u64, &Configured), RequestError> {
        let number = id.parse().ok();
        let found = number.and_then(|number| Some((number, self.configured.get(&number)?)));
        found.ok_or_else(|| RequestError::NotFound { what: "measurement configuration", id: id.to_owned() })
    }

    /// Returns a measurement configuration.
    ///
    /// # Errors
    /// [`RequestError::NotFound`].
    pub fn measurement(&self, base: &str, id: &str) -> Result<Resource<MeasurementConfig>, RequestError> {
        let (number, configured) = self.find_config(id)?;
        let href = format!("{base}/measurements/{number}");
        let links = Some(SelfLink::to(href.clone()));
        let value = MeasurementConfig { links, ..configured.config.clone() };
        Ok(Resource { value, href, etag: etag(number, configured.version) })
    }

    /// Returns links to all measurement configurations.
    pub fn measurements(&self, base: &str) -> MeasurementConfigLinkList {
        let link = |(id, configured): (&u64, &Configured)| MeasurementConfigLink {
            href: format!("{base}/measurements/{id}"),
            measurement_id: Arc::clone(&configured.config.measurement_id),
        };
        MeasurementConfigLinkList {
            links: SelfLink::to(format!("{base}/measurements")),
            measurement_config: self.configured.iter().map(link).collect(),
        }
    }

    /// Ends a measurement configuration.
    ///
    /// # Errors
    /// [`RequestError`].
    pub fn unconfigure(
        &mut self,
        now: Timestamp,
        id: &str,
        if_match: Option<&str>,
    ) -> Result<(), RequestError> {
        self.subscriptions.admit(now)?;
        let (number, configured) = self.find_config(id)?;
        check_unchanged(if_match, number, configured.version)?;
        self.configured.remove(&number);
        self.listings.forget_stations();
        Ok(())
    }
}
