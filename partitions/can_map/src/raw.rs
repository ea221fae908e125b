//! A table as it stands in its file.

use std::collections::BTreeMap;

use serde::Deserialize;
use toml::Spanned;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RawTable {
    pub(crate) sync: Option<RawSync>,
    #[serde(default)]
    pub(crate) port: BTreeMap<String, RawPort>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RawSync {
    pub(crate) frame: Spanned<String>,
    pub(crate) answer: Option<Spanned<String>>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RawPort {
    pub(crate) message: Spanned<String>,
    pub(crate) complete: Option<Spanned<String>>,
    pub(crate) stamp: Option<Spanned<String>>,
    pub(crate) age: Option<Spanned<RawSignal>>,
    pub(crate) fields: BTreeMap<String, Spanned<RawSignal>>,
}

/// A place in a frame, one of a DBC's signals, or a constant.
#[derive(Debug, Default, Clone, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct RawSignal {
    pub(crate) frame: Option<String>,
    pub(crate) start: Option<u32>,
    pub(crate) bits: Option<u32>,
    pub(crate) order: Option<String>,
    pub(crate) signed: Option<bool>,
    pub(crate) float: Option<bool>,
    pub(crate) scale: Option<f64>,
    pub(crate) offset: Option<f64>,
    pub(crate) none: Option<i64>,
    pub(crate) signal: Option<String>,
    pub(crate) constant: Option<f64>,
}

impl RawSignal {
    /// The keys that are given.
    pub(crate) fn keys(&self) -> impl Iterator<Item = &'static str> {
        let keys = [
            ("frame", self.frame.is_some()),
            ("start", self.start.is_some()),
            ("bits", self.bits.is_some()),
            ("order", self.order.is_some()),
            ("signed", self.signed.is_some()),
            ("float", self.float.is_some()),
            ("scale", self.scale.is_some()),
            ("offset", self.offset.is_some()),
            ("none", self.none.is_some()),
            ("signal", self.signal.is_some()),
            ("constant", self.constant.is_some()),
        ];
        keys.into_iter().filter(|(_, is_given)| *is_given).map(|(key, _)| key)
    }
}
