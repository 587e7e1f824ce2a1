// A peer that is Fast DDS 2: fastdds DOMAIN ACTION TYPE TOPIC QOS, as cyclone.py has them. Its types are declared here, so
// that no code generator is needed.
//
// Further actions, on all interfaces and as rmw_fastrtps has them: serve (the service TOPIC, whose requests and replies are
// of the type) and call (that service repeatedly; prints the number and the ms of each call).

#include <chrono>
#include <cstdint>
#include <cstdlib>
#include <iostream>
#include <map>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include <fastcdr/Cdr.h>
#include <fastcdr/FastBuffer.h>
#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/TopicDataType.hpp>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>
#include <fastrtps/utils/IPLocator.h>

using namespace eprosima::fastdds::dds;
using eprosima::fastcdr::Cdr;
using eprosima::fastcdr::FastBuffer;
using eprosima::fastrtps::rtps::SerializedPayload_t;

struct Header {
    int32_t sec = 5;
    uint32_t nanosec = 7;
    std::string frame_id = "from fast dds";
    template <class Visit> void fields(Visit visit) { visit(sec), visit(nanosec), visit(frame_id); }
};

struct Twist {
    static constexpr const char* name = "geometry_msgs::msg::dds_::Twist_";
    double x = 0.25, y = 0, z = 0, roll = 0, pitch = 0, yaw = -0.5;
    template <class Visit> void fields(Visit visit) {
        for (double* value : {&x, &y, &z, &roll, &pitch, &yaw}) visit(*value);
    }
};

struct TwistStamped {
    static constexpr const char* name = "geometry_msgs::msg::dds_::TwistStamped_";
    Header header;
    Twist twist;
    template <class Visit> void fields(Visit visit) { header.fields(visit), twist.fields(visit); }
};

struct LaserScan {
    static constexpr const char* name = "sensor_msgs::msg::dds_::LaserScan_";
    Header header;
    float angle_min = -3, angle_max = 3, increment = 0.5, time_increment = 0, scan_time = 0.1, range_min = 0.15,
          range_max = 12;
    std::vector<float> ranges{1.5, 1.75, 2.25}, intensities;
    template <class Visit> void fields(Visit visit) {
        header.fields(visit);
        for (float* value : {&angle_min, &angle_max, &increment, &time_increment, &scan_time, &range_min, &range_max})
            visit(*value);
        visit(ranges), visit(intensities);
    }
};

struct OccupancyGrid {
    static constexpr const char* name = "nav_msgs::msg::dds_::OccupancyGrid_";
    Header header;
    int32_t sec = 1;
    uint32_t nanosec = 2;
    float resolution = 0.5;
    uint32_t width = 2, height = 1;
    std::vector<double> origin{0, 0, 0, 0, 0, 0, 1};
    std::vector<int8_t> data{-1, 100};
    template <class Visit> void fields(Visit visit) {
        header.fields(visit), visit(sec), visit(nanosec), visit(resolution), visit(width), visit(height);
        for (double& value : origin) visit(value);
        visit(data);
    }
};

template <class T> class Support : public TopicDataType {
public:
    Support() {
        setName(T::name);
        m_typeSize = 1 << 20;
    }
    bool serialize(void* sample, SerializedPayload_t* payload) override {
        FastBuffer buffer(reinterpret_cast<char*>(payload->data), payload->max_size);
        Cdr cdr(buffer, Cdr::DEFAULT_ENDIAN, Cdr::DDS_CDR);
        payload->encapsulation = cdr.endianness() == Cdr::BIG_ENDIANNESS ? CDR_BE : CDR_LE;
        cdr.serialize_encapsulation();
        static_cast<T*>(sample)->fields([&](auto& field) { cdr << field; });
        payload->length = static_cast<uint32_t>(cdr.getSerializedDataLength());
        return true;
    }
    bool deserialize(SerializedPayload_t* payload, void* sample) override {
        FastBuffer buffer(reinterpret_cast<char*>(payload->data), payload->length);
        Cdr cdr(buffer, Cdr::DEFAULT_ENDIAN, Cdr::DDS_CDR);
        cdr.read_encapsulation();
        static_cast<T*>(sample)->fields([&](auto& field) { cdr >> field; });
        return true;
    }
    std::function<uint32_t()> getSerializedSizeProvider(void*) override {
        return [this] { return m_typeSize; };
    }
    void* createData() override { return new T(); }
    void deleteData(void* sample) override { delete static_cast<T*>(sample); }
    bool getKey(void*, InstanceHandle_t*, bool) override { return false; }
};

struct Print {
    template <class T> void operator()(const std::vector<T>& values) const {
        for (T value : values) std::cout << +value << ' ';
    }
    template <class T> void operator()(const T& value) const { std::cout << value << ' '; }
};

template <class Target> void set(Target& target, const std::string& qos) {
    target.reliability().kind = qos == "sensors" ? BEST_EFFORT_RELIABILITY_QOS : RELIABLE_RELIABILITY_QOS;
    target.durability().kind = qos == "latched" ? TRANSIENT_LOCAL_DURABILITY_QOS : VOLATILE_DURABILITY_QOS;
    target.history().kind = KEEP_LAST_HISTORY_QOS;
    target.history().depth = qos == "sensors" ? 5 : qos == "commands" ? 10 : 1;
}

DataWriter* writer_of(DomainParticipant* participant, Topic* topic, std::string qos) {
    DataWriterQos its = DATAWRITER_QOS_DEFAULT;
    set(its, qos);
    return participant->create_publisher(PUBLISHER_QOS_DEFAULT)->create_datawriter(topic, its);
}

DataReader* reader_of(DomainParticipant* participant, Topic* topic, std::string qos) {
    DataReaderQos its = DATAREADER_QOS_DEFAULT;
    set(its, qos);
    return participant->create_subscriber(SUBSCRIBER_QOS_DEFAULT)->create_datareader(topic, its);
}

template <class T> void serve(DomainParticipant* participant, Topic* requests, Topic* replies, std::string qos) {
    auto reader = reader_of(participant, requests, qos);
    auto writer = writer_of(participant, replies, qos);
    for (T sample;;) {
        SampleInfo info;
        reader->wait_for_unread_message({3600, 0});
        while (reader->take_next_sample(&sample, &info) == ReturnCode_t::RETCODE_OK) {
            if (!info.valid_data) continue;
            // The request's number, and where its client awaits the reply.
            eprosima::fastrtps::rtps::WriteParams params;
            params.related_sample_identity().writer_guid() = info.related_sample_identity.writer_guid();
            params.related_sample_identity().sequence_number() = info.sample_identity.sequence_number();
            writer->write(&sample, params);
        }
    }
}

template <class T> void call(DomainParticipant* participant, Topic* requests, Topic* replies, std::string qos) {
    auto writer = writer_of(participant, requests, qos);
    auto reader = reader_of(participant, replies, qos);
    PublicationMatchedStatus there;
    SubscriptionMatchedStatus back;
    do {
        std::this_thread::sleep_for(std::chrono::milliseconds(10));
        writer->get_publication_matched_status(there), reader->get_subscription_matched_status(back);
    } while (!there.current_count || !back.current_count);
    T sample;
    for (int number = 0;; number++) {
        eprosima::fastrtps::rtps::WriteParams params;
        params.related_sample_identity().writer_guid() = reader->guid();
        auto began = std::chrono::steady_clock::now();
        writer->write(&sample, params);
        SampleInfo info;
        while (reader->wait_for_unread_message({2, 0})) {
            if (reader->take_next_sample(&sample, &info) != ReturnCode_t::RETCODE_OK || !info.valid_data) continue;
            if (info.related_sample_identity.sequence_number() != params.sample_identity().sequence_number()) continue;
            std::chrono::duration<double, std::milli> took = std::chrono::steady_clock::now() - began;
            std::cout << "plan " << number << ' ' << took.count() << std::endl;
            break;
        }
    }
}

template <class T> void run(DomainParticipant* participant, std::string action, std::string name, std::string qos) {
    TypeSupport(new Support<T>()).register_type(participant);
    if (action == "call" || action == "serve") {
        auto requests = participant->create_topic("rq" + name + "Request", T::name, TOPIC_QOS_DEFAULT);
        auto replies = participant->create_topic("rr" + name + "Reply", T::name, TOPIC_QOS_DEFAULT);
        std::cout << "ready" << std::endl;
        (action == "call" ? call<T> : serve<T>)(participant, requests, replies, qos);
    }
    Topic* topic = participant->create_topic(name, T::name, TOPIC_QOS_DEFAULT);
    std::cout << "ready" << std::endl;
    if (action == "print") {
        auto reader = reader_of(participant, topic, qos);
        for (T sample;; sample = T()) {
            SampleInfo info;
            reader->wait_for_unread_message({3600, 0});
            while (reader->take_next_sample(&sample, &info) == ReturnCode_t::RETCODE_OK) {
                if (!info.valid_data) continue;
                sample.fields(Print());
                std::cout << std::endl;
            }
        }
    }
    auto writer = writer_of(participant, topic, qos);
    for (T sample;;) {
        writer->write(&sample);
        std::this_thread::sleep_for(std::chrono::milliseconds(action == "latch" ? 3600'000 : 20));
    }
}

int main(int count, char** args) {
    if (count != 6) return 1;
    std::string action = args[2], type = args[3], topic = args[4], qos = args[5];
    DomainParticipantQos participant_qos = PARTICIPANT_QOS_DEFAULT;
    auto transport = std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>();
    bool is_alone = action != "call" && action != "serve";
    if (is_alone) transport->interfaceWhiteList = {"127.0.0.1"};
    participant_qos.transport().use_builtin_transports = false;
    participant_qos.transport().user_transports.push_back(transport);
    eprosima::fastrtps::rtps::Locator_t peer;
    eprosima::fastrtps::rtps::IPLocator::setIPv4(peer, "127.0.0.1");
    if (is_alone) participant_qos.wire_protocol().builtin.initialPeersList.push_back(peer);
    auto participant = DomainParticipantFactory::get_instance()->create_participant(std::atoi(args[1]), participant_qos);
    if (!participant) return 1;
    if (type == "Twist") run<Twist>(participant, action, topic, qos);
    if (type == "TwistStamped") run<TwistStamped>(participant, action, topic, qos);
    if (type == "LaserScan") run<LaserScan>(participant, action, topic, qos);
    if (type == "OccupancyGrid") run<OccupancyGrid>(participant, action, topic, qos);
    return 1;
}
