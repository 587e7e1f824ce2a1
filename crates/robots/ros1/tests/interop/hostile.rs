//! The node against peers that send false lengths, stall, flood or send garbage.

use std::{
    io::{Read, Write},
    net::{TcpListener, TcpStream},
    thread,
};

use cotorra_ros1::{
    CallError, Endpoint, Node, PublishOptions, Publisher, SubscribeOptions,
    messages::{EmptyRequest, EmptyService, OccupancyGrid, Text},
};
use cotorra_testing::{
    process::{PATIENCE, until},
    ros1::Ros,
};
use proptest::{prelude::*, test_runner::TestRunner};

/// Returns a node's answer to a call of its slave API; empty if it ends the connection.
fn ask(node: &Node, body: &str) -> String {
    let endpoint = api(node);
    let mut stream = TcpStream::connect((endpoint.host.as_str(), endpoint.port)).unwrap();
    let head = format!("POST / HTTP/1.0\r\nContent-Length: {}\r\n\r\n", body.len());
    stream.write_all((head + body).as_bytes()).unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    answer
}

fn api(node: &Node) -> Endpoint {
    node.master().lookup_node(node.name()).unwrap().parse().unwrap()
}

/// Returns the address of the node's TCPROS listener.
fn tcpros(node: &Node, topic: &str) -> (String, u16) {
    let answer = ask(
        node,
        &format!(
            "<methodCall><methodName>requestTopic</methodName><params><param><value>/test</value></param>\
             <param><value>{topic}</value></param><param><value><array><data><value><array><data>\
             <value>TCPROS</value></data></array></value></data></array></value></param></params></methodCall>"
        ),
    );
    let port = answer.rsplit("<int>").next().and_then(|rest| rest.split('<').next()).unwrap();
    (api(node).host, port.parse().unwrap())
}

fn field(text: &str) -> Vec<u8> {
    [&u32::try_from(text.len()).unwrap().to_le_bytes(), text.as_bytes()].concat()
}

fn header(fields: &[&str]) -> Vec<u8> {
    let fields: Vec<u8> = fields.iter().flat_map(|text| field(text)).collect();
    [u32::try_from(fields.len()).unwrap().to_le_bytes().to_vec(), fields].concat()
}

fn works(words: &Publisher<Text>, node: &Node) {
    let heard = node.subscribe::<Text>("words", SubscribeOptions::default()).unwrap();
    until("a message arrives", || {
        words.publish(&Text { data: "x".to_owned() });
        heard.try_recv().is_some()
    });
}

#[test]
fn garbage_does_not_end_a_node() {
    let Some(ros) = Ros::start() else { return };
    let node = ros.node("robot", "/");
    let words = node.publish::<Text>("words", PublishOptions::default()).unwrap();
    let (host, port) = tcpros(&node, "/words");
    let slave = api(&node).port;
    let prefixes = [
        Vec::new(),
        b"POST / HTTP/1.1\r\nContent-Length: 40\r\n\r\n".to_vec(),
        b"POST / HTTP/1.1\r\nContent-Length: 40\r\n\r\n<methodCall><methodName>".to_vec(),
        vec![0xff; 4],
        header(&["topic=/words", "md5sum=*"]),
        header(&["topic=/words"]),
        header(&["service=/none", "md5sum=*", "probe=1"]),
        header(&["="]),
    ];
    let strategy = (prop::sample::select(prefixes.to_vec()), any::<Vec<u8>>(), any::<bool>());
    TestRunner::deterministic()
        .run(&strategy, |(prefix, bytes, to_slave)| {
            let mut stream =
                TcpStream::connect((host.as_str(), if to_slave { slave } else { port })).unwrap();
            // The node may end the connection before everything is sent.
            let _ = stream.write_all(&prefix).and_then(|()| stream.write_all(&bytes));
            Ok(())
        })
        .unwrap();
    works(&words, &node);
}

#[test]
fn unknown_methods_are_faults() {
    let Some(ros) = Ros::start() else { return };
    let node = ros.node("robot", "/");
    let words = node.publish::<Text>("words", PublishOptions::default()).unwrap();
    for body in ["", "<methodCall/>", "<methodCall><methodName>getPid", "<!DOCTYPE a []><methodCall/>"] {
        assert!(ask(&node, body).contains("<fault>"), "{body}");
    }
    let unknown = "<methodCall><methodName>explode</methodName></methodCall>";
    assert!(ask(&node, unknown).contains("nodes have no method explode"));
    let pid = ask(&node, "<methodCall><methodName>getPid</methodName></methodCall>");
    assert!(pid.contains(&format!("<int>{}</int>", std::process::id())));
    works(&words, &node);
}

#[test]
fn stalled_subscriber_gets_the_newest_and_delays_nobody() {
    let Some(ros) = Ros::start() else { return };
    let node = ros.node("robot", "/");
    let options = PublishOptions { queue: 2, latch: false };
    let maps = node.publish::<OccupancyGrid>("map", options).unwrap();
    let mut stalled = TcpStream::connect(tcpros(&node, "/map")).unwrap();
    let hello = header(&["callerid=/stalled", "topic=/map", "md5sum=*", "type=*"]);
    stalled.write_all(&hello).unwrap();
    until("the subscriber is taken in", || maps.subscribers() == 1);
    let listener = ros.node("listener", "/");
    let heard = listener.subscribe::<OccupancyGrid>("map", SubscribeOptions { queue: 1 }).unwrap();
    until("the other is, too", || maps.subscribers() == 2);

    let mut map = OccupancyGrid { data: vec![0; 1 << 20], ..OccupancyGrid::default() };
    const LAST: u32 = 100;
    for seq in 0..=LAST {
        map.header.seq = seq;
        maps.publish(&map);
        // The subscriber that does not stall receives each message.
        assert_eq!(heard.recv_timeout(PATIENCE).unwrap().header.seq, seq);
    }
    assert!(maps.dropped() > u64::from(LAST) / 2, "{}", maps.dropped());

    // Now it reads: first what the kernel held, then the newest messages, and none between.
    let mut read = || {
        let mut length = [0; 4];
        stalled.read_exact(&mut length).unwrap();
        let mut frame = vec![0; u32::from_le_bytes(length) as usize];
        stalled.read_exact(&mut frame).unwrap();
        frame
    };
    read();
    let mut heard = Vec::new();
    while heard.last() != Some(&LAST) {
        let (seq, _) =
            read().split_first_chunk().map(|(seq, rest)| (u32::from_le_bytes(*seq), rest.len())).unwrap();
        heard.push(seq);
    }
    assert!(heard.ends_with(&[LAST - 1, LAST]), "{heard:?}");
    assert!(heard.is_sorted());
}

#[test]
fn false_length_of_a_response_is_an_error() {
    let Some(ros) = Ros::start() else { return };
    let node = ros.node("robot", "/");
    let liar = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = liar.local_addr().unwrap().port();
    node.master()
        .register_service("/liar", &format!("rosrpc://127.0.0.1:{port}"), "http://127.0.0.1:1/")
        .unwrap();
    let liar = thread::spawn(move || {
        let (mut client, _) = liar.accept().unwrap();
        client.write_all(&header(&["md5sum=*"])).unwrap();
        client.write_all(&[1, 0xff, 0xff, 0xff, 0xff, 0]).unwrap();
        // Until the client closes it.
        let _ = client.read_to_end(&mut Vec::new());
    });
    let called = node.call::<EmptyService>("liar", &EmptyRequest {}, PATIENCE);
    assert!(
        matches!(&called, Err(CallError::Unreachable(error)) if error.to_string().contains("over the limit")),
        "{called:?}"
    );
    liar.join().unwrap();
}
