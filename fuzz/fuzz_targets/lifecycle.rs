//! No descriptor or request of an application's life cycle makes a reader panic, and what is read becomes a VNF, or a network
//! whose record is a descriptor of the same.
#![no_main]

use cotorra_graph::{Instruction, NodeId, Timestamp};
use cotorra_lifecycle::{
    Applications, Descriptor, NetworkDescriptor, Seen, Subscription,
    mec::{self, CreateRequest, OperationRequest},
    variables,
};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    if let Ok(text) = std::str::from_utf8(bytes) {
        let _ = variables(text);
    }
    let (mut all, now) = (Applications::default(), Timestamp::ZERO);
    if let Ok(request) = mec::read::<CreateRequest>(bytes) {
        let _ = all.create(None, request);
    }
    for operation in ["instantiate", "operate", "terminate"] {
        if let Ok(request) = OperationRequest::read(operation, bytes) {
            let _ = all.begin(None, "x", &request, now);
        }
    }
    if let Ok(subscription) = Subscription::read(bytes) {
        all.subscriptions().add(None, "http://lab", subscription, now).expect("there are no others");
    }
    let node = "edge".parse::<NodeId>().expect("a valid name");
    if let Ok(network) = NetworkDescriptor::read(bytes) {
        let uuid = network.uuid.clone();
        all.add_network(None, network.clone()).expect("there are no others");
        let record = all.connect(None, &uuid, node.clone()).expect("it was just added").record();
        assert_eq!(NetworkDescriptor::read(record.to_string().as_bytes()), Ok(network));
        all.remove_network(None, &uuid).expect("nothing uses it");
    }
    let Ok(descriptor) = Descriptor::read(bytes) else { return };
    let _ = descriptor.yaml(None);
    if let Some(uuid) = descriptor.network.clone() {
        let name = "net".to_owned();
        all.add_network(None, NetworkDescriptor { uuid, name }).expect("there are no others");
    }
    let fdu = all.onboard(None, descriptor).expect("the catalog is empty");
    let id = all.define(None, &fdu, Some(node), [None, None]).expect("it is on board").id.clone();
    all.configure(None, &id, now).expect("it is defined");
    let Ok(Instruction::AddVnf { vnf }) = all.begin_start(None, &id, "") else { panic!("it is configured") };
    assert!(vnf.cpus > 0.0 && vnf.env.is_empty());
    all.end_start(&id, Some((vnf.id.clone(), 0)), now);
    all.observe(&vnf.id, None, &Seen::Serves, now);
    // A subscription has one notification under way.
    assert!(all.subscriptions().poll(now).len() <= 1);
});
