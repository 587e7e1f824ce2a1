//! What viewers show without being told how: `visualization_msgs`, `diagnostic_msgs` and the log.

use cotorra_plugin::{
    message,
    messages::{Byte, Header, Point, Pose, Time, Vector3},
};

message! {
    /// A time span.
    #[derive(Default)]
    pub struct Duration = "builtin_interfaces/msg/Duration" {
        /// Whole seconds.
        sec: i32,
        /// Nanoseconds on top.
        nanosec: u32,
    }
}

message! {
    /// A colour; each part from 0 to 1.
    #[derive(Default)]
    pub struct ColorRGBA = "std_msgs/msg/ColorRGBA" {
        /// Red.
        r: f32,
        /// Green.
        g: f32,
        /// Blue.
        b: f32,
        /// Opacity.
        a: f32,
    }
}

message! {
    /// A picture; here always none.
    #[derive(Default)]
    pub struct CompressedImage = "sensor_msgs/msg/CompressedImage" {
        /// When and in which frame.
        header: Header,
        /// Such as `jpeg`.
        format: String,
        /// The file.
        data: Vec<u8>,
    }
}

message! {
    /// A place on a texture.
    #[derive(Default)]
    pub struct UVCoordinate = "visualization_msgs/msg/UVCoordinate" {
        /// To the right.
        u: f32,
        /// Up.
        v: f32,
    }
}

message! {
    /// A mesh; here always none.
    #[derive(Default)]
    pub struct MeshFile = "visualization_msgs/msg/MeshFile" {
        /// Its name.
        filename: String,
        /// The file.
        data: Vec<u8>,
    }
}

message! {
    /// Something to be seen.
    #[derive(Default)]
    pub struct Marker = "visualization_msgs/msg/Marker" {
        /// When and in which frame.
        header: Header,
        /// With the number below: which marker it is, so that it can be changed.
        ns: String,
        /// Which of that namespace.
        id: i32,
        /// Its shape.
        r#type: i32,
        /// 0 shows or changes it, 2 removes it.
        action: i32,
        /// Where it is.
        pose: Pose,
        /// Its size, metres; of a line its width as `x`, of text its height as `z`.
        scale: Vector3,
        /// Its colour.
        color: ColorRGBA,
        /// When it goes by itself; zero is never.
        lifetime: Duration,
        /// Whether it moves with its frame.
        frame_locked: bool,
        /// Of a line: where it goes.
        points: Vec<Point>,
        /// Of each point.
        colors: Vec<ColorRGBA>,
        /// Name of a texture.
        texture_resource: String,
        /// A texture.
        texture: CompressedImage,
        /// Where the points are on the texture.
        uv_coordinates: Vec<UVCoordinate>,
        /// Of text: what it says.
        text: String,
        /// Name of a mesh.
        mesh_resource: String,
        /// A mesh.
        mesh_file: MeshFile,
        /// Whether it has the mesh's own colours.
        mesh_use_embedded_materials: bool,
    }
}

message! {
    /// Some markers.
    #[derive(Default)]
    pub struct MarkerArray = "visualization_msgs/msg/MarkerArray" {
        /// Each.
        markers: Vec<Marker>,
    }
}

message! {
    /// A value with a name.
    #[derive(Default)]
    pub struct KeyValue = "diagnostic_msgs/msg/KeyValue" {
        /// The name.
        key: String,
        /// The value.
        value: String,
    }
}

message! {
    /// How a part is.
    #[derive(Default)]
    pub struct DiagnosticStatus = "diagnostic_msgs/msg/DiagnosticStatus" {
        /// 0 well, 1 to be looked at, 2 broken, 3 unknown.
        level: Byte,
        /// Which part.
        name: String,
        /// How it is, for people.
        message: String,
        /// On which node.
        hardware_id: String,
        /// Its figures.
        values: Vec<KeyValue>,
    }
}

message! {
    /// How parts are.
    #[derive(Default)]
    pub struct DiagnosticArray = "diagnostic_msgs/msg/DiagnosticArray" {
        /// When.
        header: Header,
        /// Each.
        status: Vec<DiagnosticStatus>,
    }
}

message! {
    /// A line of the log.
    #[derive(Default)]
    pub struct Log = "rcl_interfaces/msg/Log" {
        /// When.
        stamp: Time,
        /// 20 for what is well, 30 for a warning, 40 for an error.
        level: u8,
        /// Who says it.
        name: String,
        /// What.
        msg: String,
        /// Where in the source; empty.
        file: String,
        /// The same.
        function: String,
        /// The same.
        line: u32,
    }
}
