//! The attributes of the data types that can be queried (ETSI GS MEC 028 v2.3.1, clauses 6.2 and 6.5). All are
//! listed: the standard lets filters and selectors also name attributes that this service omits.

use cotorra_mec::{
    Attribute,
    Kind::{Flag, Number},
};

/// Declares a data type whose attributes all have one kind, none of them an array.
macro_rules! alike {
    ($data_type:ident $required:literal $kind:ident: $($name:literal)*) => {
        static $data_type: &[Attribute] =
            &[$( Attribute { name: $name, kind: $kind, many: false, required: $required } ),*];
    };
}

cotorra_mec::attributes! {
    pub(crate) AP_INFO {
        !"apId": (AP_IDENTITY),
        "timeStamp": (TIME_STAMP),
        "channel": Number,
        "wlanCap": (WLAN_CAPABILITIES),
        "wanMetrics": (WAN_METRICS),
        "bssLoad": (BSS_LOAD),
        "extBssLoad": (EXT_BSS_LOAD),
        "oBssLoad": (O_BSS_LOAD),
        "apLocation": (AP_LOCATION),
    }
    pub(crate) STA_INFO {
        !"staId": (STA_IDENTITY),
        "timeStamp": (TIME_STAMP),
        "channel": Number,
        "apAssociated": (AP_ASSOCIATED),
        "rssi": (RSSI),
        "staDataRate": (STA_DATA_RATE),
        "staStatistics": [(STA_STATISTICS)],
        "beaconReport": [(BEACON_REPORT)],
        "neighborReport": [(NEIGHBOR_REPORT)],
        "channelLoad": [(CHANNEL_LOAD)],
    }
    AP_IDENTITY { !"bssid": Address, "ssid": [Text], "ipAddress": [Text], }
    STA_IDENTITY { !"macId": Address, "ssid": [Text], "aid": Text, "ipAddress": [Text], }
    AP_ASSOCIATED { !"bssid": Address, "ssid": [Text], "assocId": Text, "ipAddress": [Text], }
    RSSI { !"rssi": Number, }
    STA_DATA_RATE {
        "staId": (STA_IDENTITY),
        "staLastDataDownlinkRate": Number,
        "staLastDataUplinkRate": Number,
    }
    WLAN_CAPABILITIES {
        "ht": (HT_CAPABILITIES),
        "vht": (VHT_CAPABILITIES),
        "he": (HE_CAPABILITIES),
        "dmg": (DMG_CAPABILITIES),
        "edmg": (EDMG_CAPABILITIES),
    }
    AP_LOCATION { "geolocation": (GEO_LOCATION), "civicLocation": (CIVIC_LOCATION), }
    O_BSS_LOAD {
        !"allocatedTrafficSelfMean": Number,
        !"allocatedTrafficShareMean": Number,
        "allocatedTrafficSelfStdDev": Number,
        "allocatedTrafficShareStdDev": Number,
        "overlap": Number,
    }
    GEO_LOCATION {
        !"latUncertainty": Number,
        !"lat": Number,
        !"longUncertainty": Number,
        !"long": Number,
        !"datum": Number,
        "altitudeType": Number,
        "altitudeUncertainty": Number,
        "altitude": Number,
    }
    STA_STATISTICS {
        !"measurementId": Text,
        !"measurementDuration": Number,
        !"groupIdentity": Number,
        "staId": (STA_IDENTITY),
        "groupZeroData": (GROUP_ZERO),
        "groupOneData": (GROUP_ONE),
        "group2to9Data": (GROUP_2_TO_9),
    }
    GROUP_ZERO {
        !"transmittedFragmentCount": Number,
        !"groupTransmittedFrameCount": Number,
        !"failedCount": Number,
        !"receivedFragmentCount": Number,
        !"groupReceivedFrameCount": Number,
        !"fcsErrorCount": Number,
        !"transmittedFrameCount": Number,
        "reportingReasonStaCounters": (REASON_STA),
    }
    GROUP_ONE {
        !"retryCount": Number,
        !"multipleRetryCount": Number,
        !"frameDuplicateCount": Number,
        !"rtsSuccessCount": Number,
        !"rtsFailureCount": Number,
        !"ackFailureCount": Number,
        "reportingReasonStaCounters": (REASON_STA),
    }
    GROUP_2_TO_9 {
        !"qosTransmittedFragmentCount": Number,
        !"qosFailedCount": Number,
        !"qosRetryCount": Number,
        !"qosMultipleRetryCount": Number,
        !"qosFrameDuplicateCount": Number,
        !"qosRTSSuccessCount": Number,
        !"qosRTSFailureCount": Number,
        !"qosAckFailureCount": Number,
        !"qosReceivedFragmentCount": Number,
        !"qosTransmittedFrameCount": Number,
        !"qosDiscardedFrameCount": Number,
        !"qosMPDUsReceivedCount": Number,
        !"qosRetriesReceivedCount": Number,
        "reportingReasonQoSCounters": (REASON_QOS),
    }
    BEACON_REPORT {
        !"measurementId": Text,
        !"operatingClass": Number,
        !"channel": Number,
        !"reportedFrameInfo": (FRAME_INFO),
        !"bssid": Address,
        "staId": (STA_IDENTITY),
        "ssid": Text,
        "rcpi": Number,
        "rsni": Number,
        "antennaId": Number,
        "parentTsf": Number,
    }
    NEIGHBOR_REPORT {
        !"measurementId": Text,
        !"bssid": Address,
        !"bssidInfo": (BSSID_INFO),
        !"operatingClass": Number,
        !"channel": Number,
        !"phyType": Number,
        "staId": (STA_IDENTITY),
        "bssTransitionCandidatePreference": Number,
    }
    BSSID_INFO {
        !"apReachability": Number,
        !"security": Flag,
        !"capabilities": (BSS_CAPABILITIES),
        !"mobilityDomain": Flag,
        !"highThroughput": Flag,
        !"veryHighThroughput": Flag,
        !"ftm": Flag,
    }
    CHANNEL_LOAD {
        !"measurementId": Text,
        !"operatingClass": Number,
        !"channel": Number,
        !"measurementDuration": Number,
        !"channelLoad": Number,
        "staId": (STA_IDENTITY),
    }
    CIVIC_LOCATION {
        !"country": Text,
        "ca0": Text, "ca1": Text, "ca2": Text, "ca3": Text, "ca4": Text, "ca5": Text, "ca6": Text, "ca16": Text,
        "ca17": Text, "ca18": Text, "ca19": Text, "ca20": Text, "ca21": Text, "ca22": Text, "ca23": Text,
        "ca24": Text, "ca25": Text, "ca26": Text, "ca27": Text, "ca28": Text, "ca29": Text, "ca30": Text,
        "ca31": Text, "ca32": Text, "ca33": Text, "ca34": Text, "ca35": Text, "ca36": Text, "ca37": Text,
        "ca38": Text, "ca39": Text, "ca128": Text,
    }
}

alike! { TIME_STAMP true Number: "seconds" "nanoSeconds" }
alike! { WAN_METRICS true Number:
"wanInfo" "downlinkSpeed" "uplinkSpeed" "downlinkLoad" "uplinkLoad" "lmd" }
alike! { BSS_LOAD true Number: "staCount" "channelUtilization" "availAdmCap" }
alike! { EXT_BSS_LOAD true Number:
"muMimoStaCount" "spatStreamUnderUtil" "obsSec20MhzUtil" "obsSec40MhzUtil" "obsSec80MhzUtil" }
alike! { HT_CAPABILITIES true Number:
"htCapabilityInfo" "ampduParameters" "supportedMcsSet" "htExtendedCap" "txBeamFormCap" "aselCap" }
alike! { VHT_CAPABILITIES true Number: "vhtCapInfo" "vhtMcsNss" }
alike! { HE_CAPABILITIES true Number: "heMacCapInfo" "hePhyCapinfo" "supportedHeMcsNssSet" }
alike! { DMG_CAPABILITIES true Number:
"dmgStaCapInfo" "dmgApOrPcpCapInfo" "dmgStaBeamTrackTimeLimit" "ExtScMcsCap" "maxNrBasicAmsduSubframes"
"maxNrShortAmsduSubframes" }
alike! { EDMG_CAPABILITIES false Number: "ampduParameters" "trnParameters" "supportedMcs" }
alike! { FRAME_INFO true Number: "phyType" "frameType" }
alike! { BSS_CAPABILITIES true Flag:
"spectrumManagement" "qos" "apsd" "radioMeasurements" "delayedBACK" "immediateBACK" }
alike! { REASON_STA true Flag:
"failed" "fcsError" "multipleRetry" "frameDuplicate" "rtsFailure" "ackFailure" "retry" }
alike! { REASON_QOS true Flag:
"qosFailed" "qosRetry" "qosMultipleRetry" "qosFrameDuplicate" "qosRtsFailure" "qosAckFailure" "qosDiscarded" }
