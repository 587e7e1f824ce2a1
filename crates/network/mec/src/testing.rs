//! Data types for tests, as the WLAN Access Information Service has them.

crate::attributes! {
    pub(crate) ACCESS_POINT {
        !"apId": (IDENTITY),
        "timeStamp": (TIME_STAMP),
        "channel": Number,
        "bssLoad": (LOAD),
    }
    pub(crate) STATION {
        !"staId": (STATION_IDENTITY),
        "channel": Number,
        "apAssociated": (IDENTITY),
        "rssi": (RSSI),
        "beaconReport": [(BEACON_REPORT)],
        "neighborReport": [(NEIGHBOR_REPORT)],
    }
    IDENTITY { !"bssid": Address, "ssid": [Text], "ipAddress": [Text], }
    STATION_IDENTITY { !"macId": Address, "ssid": [Text], "aid": Text, "ipAddress": [Text], }
    TIME_STAMP { !"seconds": Number, !"nanoSeconds": Number, }
    LOAD { !"staCount": Number, !"channelUtilization": Number, !"availAdmCap": Number, }
    RSSI { !"rssi": Number, }
    BEACON_REPORT { !"measurementId": Text, !"channel": Number, !"bssid": Address, "rcpi": Number, }
    NEIGHBOR_REPORT { !"bssidInfo": (BSSID_INFO), }
    BSSID_INFO { !"mobilityDomain": Flag, !"ftm": Flag, }
}
