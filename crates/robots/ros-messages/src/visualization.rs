//! `visualization_msgs`, `diagnostic_msgs` and the log: what viewers show without configuration.

use crate::{Byte, ColorRGBA, CompressedImage, Duration, Header, Point, Pose, Time, Vector3, message};

message! {
    /// A position on a texture.
    #[derive(Copy, Default)]
    pub struct UVCoordinate = "visualization_msgs" / "UVCoordinate" {
        /// To the right.
        u: f32,
        /// Up.
        v: f32,
    }
}

message! {
    /// A mesh.
    #[derive(Default)]
    pub struct MeshFile = "visualization_msgs" / "MeshFile" {
        /// Its name.
        filename: String,
        /// The file.
        data: Vec<u8>,
    }
}

message! {
    /// A shape for viewers.
    #[derive(Default)]
    pub struct Marker = "visualization_msgs" / "Marker" {
        /// Time and frame of the marker.
        header: Header,
        /// Namespace of `id`.
        ns: String,
        /// Number of the marker in its namespace, by which it can be changed.
        id: i32,
        /// Its shape.
        r#type: i32,
        /// 0 adds or changes it, 2 removes it.
        action: i32,
        /// Its pose.
        pose: Pose,
        /// Its size, metres; of a line its width as `x`, of text its height as `z`.
        scale: Vector3,
        /// Its colour.
        color: ColorRGBA,
        /// Time after which it disappears; zero means never.
        lifetime: Duration,
        /// Whether it moves with its frame.
        frame_locked: bool,
        /// Points of a line.
        points: Vec<Point>,
        /// Colour of each point.
        colors: Vec<ColorRGBA>,
        /// Name of a texture.
        texture_resource: String [Ros2 only],
        /// A texture.
        texture: CompressedImage [Ros2 only],
        /// Position of each point on the texture.
        uv_coordinates: Vec<UVCoordinate> [Ros2 only],
        /// Its text.
        text: String,
        /// Name of a mesh.
        mesh_resource: String,
        /// A mesh.
        mesh_file: MeshFile [Ros2 only],
        /// Whether it has the mesh's own colours.
        mesh_use_embedded_materials: bool,
    }
}

message! {
    /// Several markers.
    #[derive(Default)]
    pub struct MarkerArray = "visualization_msgs" / "MarkerArray" {
        /// The markers.
        markers: Vec<Marker>,
    }
}

message! {
    /// A value with a name.
    #[derive(Default)]
    pub struct KeyValue = "diagnostic_msgs" / "KeyValue" {
        /// The name.
        key: String,
        /// The value.
        value: String,
    }
}

message! {
    /// The condition of a component.
    #[derive(Default)]
    pub struct DiagnosticStatus = "diagnostic_msgs" / "DiagnosticStatus" {
        /// 0 for OK, 1 for a warning, 2 for an error, 3 for stale.
        level: Byte,
        /// The component.
        name: String,
        /// Its condition, for people.
        message: String,
        /// The hardware that it belongs to.
        hardware_id: String,
        /// Its figures.
        values: Vec<KeyValue>,
    }
}

message! {
    /// Conditions of several components.
    #[derive(Default)]
    pub struct DiagnosticArray = "diagnostic_msgs" / "DiagnosticArray" {
        /// Time of the diagnosis.
        header: Header,
        /// One for each component.
        status: Vec<DiagnosticStatus>,
    }
}

message! {
    /// A line of ROS 2's log. ROS 1 has `rosgraph_msgs/Log` instead.
    #[derive(Default)]
    pub struct Log = "rcl_interfaces" / "Log" {
        /// Time of the line.
        stamp: Time,
        /// 20 for information, 30 for a warning, 40 for an error.
        level: u8,
        /// The logger.
        name: String,
        /// The text.
        msg: String,
        /// Source file.
        file: String,
        /// Function in the source file.
        function: String,
        /// Line in the source file.
        line: u32,
    }
}
