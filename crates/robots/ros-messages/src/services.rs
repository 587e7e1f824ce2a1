//! Services of ROS 1: a request that gets one response.

use crate::{Message, OccupancyGrid, message};

/// A ROS 1 service.
pub trait Service: 'static {
    /// The type's name, such as `std_srvs/SetBool`.
    const TYPE_NAME: &'static str;
    /// The request.
    type Request: Message;
    /// The response.
    type Response: Message;

    /// The MD5 sum of the service, in hexadecimal.
    fn md5sum() -> String {
        let (request, response) = (Self::Request::description(), Self::Response::description());
        format!("{:x}", md5::compute(request.md5_text() + &response.md5_text()))
    }
}

message! {
    /// A request without details.
    #[derive(Default)]
    pub struct EmptyRequest = "std_srvs" / "EmptyRequest" {}
}

message! {
    /// Confirms that the request was carried out.
    #[derive(Default)]
    pub struct EmptyResponse = "std_srvs" / "EmptyResponse" {}
}

/// Requests something that needs no details; `std_srvs/Empty`.
#[derive(Debug, Clone, Copy)]
pub struct EmptyService;

impl Service for EmptyService {
    const TYPE_NAME: &'static str = "std_srvs/Empty";
    type Request = EmptyRequest;
    type Response = EmptyResponse;
}

message! {
    /// Requests to switch something.
    #[derive(Default)]
    pub struct SetBoolRequest = "std_srvs" / "SetBoolRequest" {
        /// Whether to switch it on.
        data: bool,
    }
}

message! {
    /// The result of switching.
    #[derive(Default)]
    pub struct SetBoolResponse = "std_srvs" / "SetBoolResponse" {
        /// Whether it was switched.
        success: bool,
        /// Details, for people.
        message: String,
    }
}

/// Switches something on or off; `std_srvs/SetBool`.
#[derive(Debug, Clone, Copy)]
pub struct SetBool;

impl Service for SetBool {
    const TYPE_NAME: &'static str = "std_srvs/SetBool";
    type Request = SetBoolRequest;
    type Response = SetBoolResponse;
}

message! {
    /// Requests the map.
    #[derive(Default)]
    pub struct GetMapRequest = "nav_msgs" / "GetMapRequest" {}
}

message! {
    /// Returns the map.
    #[derive(Default)]
    pub struct GetMapResponse = "nav_msgs" / "GetMapResponse" {
        /// The map.
        map: OccupancyGrid,
    }
}

/// Requests the map; `nav_msgs/GetMap`, as `/static_map` serves it.
#[derive(Debug, Clone, Copy)]
pub struct GetMap;

impl Service for GetMap {
    const TYPE_NAME: &'static str = "nav_msgs/GetMap";
    type Request = GetMapRequest;
    type Response = GetMapResponse;
}
