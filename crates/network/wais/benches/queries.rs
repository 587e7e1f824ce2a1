//! Benchmarks HTTP queries to the service of 50 access points and 500 stations, surveyed every 20 ms: queries per
//! second, their latency, and queries per second of CPU time. Run with `cargo bench -p cotorra-wais`.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::disallowed_types,
    reason = "a benchmark uses the wall clock"
)]

use std::{
    collections::BTreeMap,
    fmt::Write as _,
    io::{BufRead, BufReader, Read, Write},
    net::{SocketAddr, TcpListener, TcpStream},
    path::Path,
    sync::Arc,
    thread,
    time::{Duration, Instant},
};

use axum::{Router, routing::get};
use cotorra_graph::{Dbm, NodeId, RadioContext, StationContext, Timestamp};
use cotorra_mec::{Allowed, Epoch, Testbed};
use cotorra_wais::{
    Scope, Site, Survey, Wais,
    http::{Service, router},
};
use hdrhistogram::Histogram;

const ACCESS_POINTS: usize = 50;
const STATIONS: usize = 500;
const CLIENTS: usize = 4;
const QUERIES: usize = 10_000;

struct Campus {
    began: Instant,
    radio: BTreeMap<NodeId, RadioContext>,
}

impl Testbed<Wais> for Campus {
    fn now(&self) -> Timestamp {
        Timestamp::ZERO + self.began.elapsed()
    }

    fn survey(&self, site: &Arc<Site>) -> Survey {
        site.survey(self.now(), &self.radio, &BTreeMap::new(), &BTreeMap::new())
    }

    fn freshness(&self) -> Duration {
        Duration::from_millis(20)
    }

    fn tell(&self, message: String) {
        eprintln!("{message}");
    }
}

fn serve() -> SocketAddr {
    let mut text = "name: campus\nwireless: { campus: {} }\nnodes:\n".to_owned();
    for station in 0..STATIONS {
        writeln!(text, "  s{station}: {{ kind: robot, position: [{station}, 1] }}").unwrap();
    }
    for ap in 0..ACCESS_POINTS {
        let channel = 1 + ap % 3 * 5;
        writeln!(text, "  a{ap}: {{ kind: radio_unit, position: [{ap}, 0], channel: {channel} }}").unwrap();
    }
    let units: Vec<_> = (0..ACCESS_POINTS).map(|ap| format!("a{ap}")).collect();
    writeln!(text, "  lan: {{ kind: switch }}\nlinks: [{{ ends: [lan, [{}]] }}]", units.join(", ")).unwrap();
    let testbed =
        cotorra_testbed_file::parse("campus.yaml", &text, Path::new("")).expect("a valid testbed file");
    let radio = (0..ACCESS_POINTS).map(|ap| {
        let id = NodeId::new(&format!("a{ap}")).unwrap();
        let stations = (ap..STATIONS).step_by(ACCESS_POINTS).map(|station| StationContext {
            robot: NodeId::new(&format!("s{station}")).unwrap(),
            signal: Dbm(-40.0 - (station % 50) as f64),
            downlink_bps: 65e6,
            uplink_bps: 58.5e6,
            counted: Default::default(),
        });
        let load = ap as f64 / ACCESS_POINTS as f64;
        let channel = 1 + ap as u8 % 3 * 5;
        (id.clone(), RadioContext { radio_unit: id, channel, load: Some(load), stations: stations.collect() })
    });
    let campus = Arc::new(Campus { began: Instant::now(), radio: radio.collect() });
    let site = Site::new(&testbed.graph, &testbed.wais, &Scope::Testbed);
    let service = Service::new(
        campus,
        Wais::new(Arc::new(site), Epoch::default()),
        Allowed::new([]).and_loopback(),
        "/wai/v2".to_owned(),
    );
    let cpu = || async { std::fs::read_to_string("/proc/thread-self/schedstat").unwrap() };
    let app = Router::new().nest("/wai/v2", router(&service)).route("/cpu", get(cpu));
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    listener.set_nonblocking(true).unwrap();
    let address = listener.local_addr().unwrap();
    thread::spawn(move || {
        // One thread, as in a run.
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        runtime.block_on(async {
            let listener = tokio::net::TcpListener::from_std(listener).unwrap();
            axum::serve(listener, app).await.unwrap();
        });
    });
    address
}

struct Client(BufReader<TcpStream>);

impl Client {
    fn new(address: SocketAddr) -> Self {
        let stream = TcpStream::connect(address).unwrap();
        stream.set_nodelay(true).unwrap();
        Self(BufReader::with_capacity(1 << 16, stream))
    }

    fn get(&mut self, path: &str) -> Vec<u8> {
        let request = format!("GET {path} HTTP/1.1\r\nHost: wais.lab\r\n\r\n");
        self.0.get_mut().write_all(request.as_bytes()).unwrap();
        let (mut line, mut length) = (String::new(), 0);
        self.0.read_line(&mut line).unwrap();
        assert!(line.starts_with("HTTP/1.1 200"), "{path}: {line}");
        while line != "\r\n" {
            line.clear();
            self.0.read_line(&mut line).unwrap();
            if let Some(digits) = line.strip_prefix("content-length: ") {
                length = digits.trim().parse().unwrap();
            }
        }
        let mut body = vec![0; length];
        self.0.read_exact(&mut body).unwrap();
        body
    }
}

/// Returns the seconds of CPU time that the server's thread has used.
fn cpu(address: SocketAddr) -> f64 {
    let text = String::from_utf8(Client::new(address).get("/cpu")).unwrap();
    text.split(' ').next().unwrap().parse::<f64>().unwrap() / 1e9
}

fn measure(address: SocketAddr, name: &str, paths: &[String]) {
    let (began, cpu_before) = (Instant::now(), cpu(address));
    let clients = (0..CLIENTS).map(|place| {
        let paths = paths.to_owned();
        thread::spawn(move || {
            let mut client = Client::new(address);
            let (mut times, mut bytes) = (Histogram::<u64>::new(3).unwrap(), 0);
            for i in 0..QUERIES / CLIENTS {
                let path = &paths[(i + place) % paths.len()];
                let asked = Instant::now();
                bytes += client.get(path).len();
                times.record(asked.elapsed().as_micros() as u64).unwrap();
            }
            (times, bytes)
        })
    });
    let (mut times, mut bytes) = (Histogram::<u64>::new(3).unwrap(), 0);
    for client in clients.collect::<Vec<_>>() {
        let (own, read) = client.join().unwrap();
        times.add(own).unwrap();
        bytes += read;
    }
    let (took, on_core) = (began.elapsed().as_secs_f64(), cpu(address) - cpu_before);
    let ms = |quantile: f64| times.value_at_quantile(quantile) as f64 / 1e3;
    println!(
        "| {name} | {:.1} | {:.0} | {:.0} | {:.2} | {:.2} | {:.2} |",
        bytes as f64 / QUERIES as f64 / 1e3,
        QUERIES as f64 / took,
        QUERIES as f64 / on_core,
        ms(0.5),
        ms(0.99),
        times.max() as f64 / 1e3,
    );
}

fn load_average() -> String {
    std::fs::read_to_string("/proc/loadavg").unwrap().split(' ').next().unwrap().to_owned()
}

fn main() {
    let address = serve();
    let ap = "02:77:00:00:01:f5";
    let kinds = [
        (
            "one station by its address",
            "sta/sta_information?filter=(eq,staId/macId,02:77:00:00:00:10)".to_owned(),
        ),
        (
            "stations of an access point, by their signal",
            format!("sta/sta_information?filter=(eq,apAssociated/bssid,{ap});(lt,rssi/rssi,150)"),
        ),
        (
            "loaded access points, one attribute",
            "ap/ap_information?filter=(gt,bssLoad/channelUtilization,200)&fields=bssLoad".to_owned(),
        ),
        ("all access points", "ap/ap_information".to_owned()),
        ("all stations", "sta/sta_information".to_owned()),
    ];
    let path = |path: &str| format!("/wai/v2/queries/{path}");
    println!(
        "{ACCESS_POINTS} access points, {STATIONS} stations, {CLIENTS} clients; load average {} before",
        load_average()
    );
    println!("| query | kB | queries/s | queries a CPU second | median ms | p99 ms | worst ms |");
    println!("|---|---:|---:|---:|---:|---:|---:|");
    let all: Vec<_> = kinds.iter().map(|(_, query)| path(query)).collect();
    for (name, query) in &kinds {
        measure(address, name, &[path(query)]);
    }
    measure(address, "all of these in turn", &all);
    println!("load average {} after", load_average());
}
