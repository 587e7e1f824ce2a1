//! No descriptor or request of an application's life cycle makes a reader panic, and what is read becomes a VNF.
#![no_main]

use cotorra_lifecycle::{
    Applications, Descriptor,
    mec::{self, CreateRequest, InstantiateRequest, OperateRequest, TerminateRequest},
    variables,
};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    if let Ok(text) = std::str::from_utf8(bytes) {
        let _ = variables(text);
    }
    let _ = mec::read::<InstantiateRequest>(bytes).and_then(|request| request.node());
    let mut all = Applications::default();
    if let Ok(request) = mec::read::<CreateRequest>(bytes) {
        let _ = all.create(None, request);
    }
    if let Ok(request) = mec::read::<OperateRequest>(bytes) {
        let _ = all.operate(None, "x", &request, 0);
    }
    if let Ok(request) = mec::read::<TerminateRequest>(bytes) {
        let _ = all.terminate(None, "x", &request, 0);
    }
    let Ok(descriptor) = Descriptor::read(bytes) else { return };
    let _ = descriptor.yaml(None);
    let node = "edge".parse().expect("a valid name");
    let fdu = all.onboard(None, descriptor).expect("the catalog is empty");
    let id = all.define(None, &fdu, Some(node), [None, None]).expect("it is on board").id.clone();
    all.configure(None, &id).expect("it is defined");
    let vnf = all.begin_start(None, &id, "").expect("it is configured");
    assert!(vnf.cpus > 0.0 && vnf.env.is_empty());
});
