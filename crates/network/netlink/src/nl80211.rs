//! Numbers of nl80211, the family of Wi-Fi (linux/nl80211.h).

use crate::attributes::Writer;

/// Name of the family.
pub const FAMILY: &str = "nl80211";

/// Commands.
pub mod command {
    /// `NL80211_CMD_GET_WIPHY`.
    pub const GET_WIPHY: u8 = 1;
    /// `NL80211_CMD_SET_WIPHY`.
    pub const SET_WIPHY: u8 = 2;
    /// `NL80211_CMD_GET_INTERFACE`.
    pub const GET_INTERFACE: u8 = 5;
    /// `NL80211_CMD_NEW_INTERFACE`.
    pub const NEW_INTERFACE: u8 = 7;
    /// `NL80211_CMD_GET_STATION`.
    pub const GET_STATION: u8 = 17;
    /// `NL80211_CMD_SET_WIPHY_NETNS`.
    pub const SET_WIPHY_NETNS: u8 = 49;
    /// `NL80211_CMD_GET_SURVEY`.
    pub const GET_SURVEY: u8 = 50;
}

/// Attributes of messages.
pub mod attribute {
    /// `NL80211_ATTR_WIPHY`.
    pub const WIPHY: u16 = 1;
    /// `NL80211_ATTR_WIPHY_NAME`.
    pub const WIPHY_NAME: u16 = 2;
    /// `NL80211_ATTR_IFINDEX`.
    pub const IFINDEX: u16 = 3;
    /// `NL80211_ATTR_IFNAME`.
    pub const IFNAME: u16 = 4;
    /// `NL80211_ATTR_IFTYPE`.
    pub const IFTYPE: u16 = 5;
    /// `NL80211_ATTR_MAC`.
    pub const MAC: u16 = 6;
    /// `NL80211_ATTR_STA_INFO`.
    pub const STA_INFO: u16 = 21;
    /// `NL80211_ATTR_SSID`.
    pub const SSID: u16 = 52;
    /// `NL80211_ATTR_SURVEY_INFO`.
    pub const SURVEY_INFO: u16 = 84;
    /// `NL80211_ATTR_WIPHY_TX_POWER_SETTING`.
    pub const TX_POWER_SETTING: u16 = 97;
    /// `NL80211_ATTR_WIPHY_TX_POWER_LEVEL`: i32 in a u32, in mBm, i.e. hundredths of dBm.
    pub const TX_POWER_LEVEL: u16 = 98;
    /// `NL80211_ATTR_SPLIT_WIPHY_DUMP`.
    pub const SPLIT_WIPHY_DUMP: u16 = 174;
    /// `NL80211_ATTR_NETNS_FD`.
    pub const NETNS_FD: u16 = 219;
}

/// Kinds of interfaces.
pub mod interface_type {
    /// `NL80211_IFTYPE_STATION`.
    pub const STATION: u32 = 2;
    /// `NL80211_IFTYPE_AP`.
    pub const AP: u32 = 3;
    /// `NL80211_IFTYPE_MESH_POINT`.
    pub const MESH_POINT: u32 = 7;
    /// `NL80211_IFTYPE_P2P_CLIENT`.
    pub const P2P_CLIENT: u32 = 8;
    /// `NL80211_IFTYPE_P2P_GO`.
    pub const P2P_GO: u32 = 9;
}

/// Ways to set a transmit power (`enum nl80211_tx_power_setting`).
pub mod power_setting {
    /// `NL80211_TX_POWER_AUTOMATIC`.
    pub const AUTOMATIC: u32 = 0;
    /// `NL80211_TX_POWER_LIMITED`.
    pub const LIMITED: u32 = 1;
    /// `NL80211_TX_POWER_FIXED`.
    pub const FIXED: u32 = 2;
}

/// Begins the attributes of a request that concerns an interface.
pub fn of_interface(index: u32) -> Writer {
    let mut writer = Writer::default();
    writer.words(attribute::IFINDEX, &[index]);
    writer
}
