// Runs a scenario of cotorra's referee in ns-3, and prints what its robots measured.
//
//   scenario SCENARIO.json SEED > RESULT.json
//
// The scenario has radio units, robots with their places over time, wires, what robots send, and sources of traffic.
// `src/scenario.rs` describes its keys, which have SI units. Every robot has one radio for each radio unit that it uses, and
// sends by the one that the scenario names at the time: changing over takes no time here.

#include "ns3/core-module.h"
#include "ns3/internet-module.h"
#include "ns3/mobility-module.h"
#include "ns3/network-module.h"
#include "ns3/point-to-point-module.h"
#include "ns3/traffic-control-module.h"
#include "ns3/wifi-module.h"

#include <cmath>
#include <fstream>
#include <functional>
#include <iomanip>
#include <iostream>
#include <limits>
#include <map>
#include <sstream>
#include <stdexcept>
#include <vector>

using namespace ns3;

namespace
{

// ---------------------------------------------------------------------------------------------------------------- JSON

/// A value of a JSON document.
class Json
{
  public:
    static Json Read(const std::string& text)
    {
        size_t at = 0;
        Json value = Value(text, at);
        return value;
    }

    const Json& operator[](const std::string& key) const
    {
        auto found = m_fields.find(key);
        if (found == m_fields.end())
        {
            throw std::runtime_error("the scenario lacks `" + key + "`");
        }
        return found->second;
    }

    bool Has(const std::string& key) const
    {
        auto found = m_fields.find(key);
        return found != m_fields.end() && !found->second.m_isNull;
    }

    const std::vector<Json>& Items() const { return m_items; }
    const std::map<std::string, Json>& Fields() const { return m_fields; }
    double Number() const { return m_number; }
    bool Flag() const { return m_number != 0; }
    const std::string& Text() const { return m_text; }

  private:
    static void Skip(const std::string& text, size_t& at)
    {
        while (at < text.size() && std::isspace(static_cast<unsigned char>(text[at])))
        {
            ++at;
        }
    }

    static std::string String(const std::string& text, size_t& at)
    {
        std::string out;
        for (++at; at < text.size() && text[at] != '"'; ++at)
        {
            // Names of nodes and services have no other escapes.
            out += text[at] == '\\' ? text[++at] : text[at];
        }
        ++at;
        return out;
    }

    static Json Value(const std::string& text, size_t& at)
    {
        Skip(text, at);
        if (at >= text.size())
        {
            throw std::runtime_error("the scenario ends too early");
        }
        Json value;
        const char first = text[at];
        if (first == '{' || first == '[')
        {
            const char last = first == '{' ? '}' : ']';
            for (Skip(text, ++at); at < text.size() && text[at] != last; Skip(text, at))
            {
                if (first == '{')
                {
                    std::string key = String(text, at);
                    Skip(text, at);
                    value.m_fields.emplace(std::move(key), Value(text, ++at));
                }
                else
                {
                    value.m_items.push_back(Value(text, at));
                }
                Skip(text, at);
                at += at < text.size() && text[at] == ',';
            }
            ++at;
        }
        else if (first == '"')
        {
            value.m_text = String(text, at);
        }
        else if (text.compare(at, 4, "true") == 0)
        {
            value.m_number = 1;
            at += 4;
        }
        else if (text.compare(at, 5, "false") == 0)
        {
            at += 5;
        }
        else if (text.compare(at, 4, "null") == 0)
        {
            value.m_isNull = true;
            at += 4;
        }
        else
        {
            size_t length = 0;
            value.m_number = std::stod(text.substr(at, 40), &length);
            at += length;
        }
        return value;
    }

    std::map<std::string, Json> m_fields;
    std::vector<Json> m_items;
    std::string m_text;
    double m_number = 0;
    bool m_isNull = false;
};

// -------------------------------------------------------------------------------------------------------- Applications

constexpr uint16_t ANSWERS = 7000;
constexpr uint16_t TAKES = 7001;
/// Port of nobody.
constexpr uint16_t DISCARD = 9;
/// Port of the first source of traffic.
constexpr uint16_t TRAFFIC = 8000;
/// Bytes of an Ethernet header.
constexpr uint32_t ETHERNET = 14;

/// The beginning of a request and of its answer.
struct Header
{
    uint32_t service;
    uint32_t sequence;
    uint32_t answerBytes;
    uint32_t processingUs;
};

Ptr<Packet>
MakePacket(const Header& header, uint32_t bytes)
{
    Ptr<Packet> packet = Create<Packet>(reinterpret_cast<const uint8_t*>(&header), sizeof(Header));
    packet->AddAtEnd(Create<Packet>(std::max<uint32_t>(bytes, sizeof(Header)) - sizeof(Header)));
    return packet;
}

Header
ReadHeader(Ptr<const Packet> packet)
{
    Header header{};
    packet->CopyData(reinterpret_cast<uint8_t*>(&header), sizeof(Header));
    return header;
}

/// A robot's place on the network: where its packets go now.
class Robot
{
  public:
    Ptr<Node> node;
    /// The radio unit that carries its packets now.
    std::string unit;
    /// Ethernet frames from it at radio units, bytes.
    uint64_t bytes = 0;
};

using Addresses = std::map<std::pair<std::string, std::string>, Ipv4Address>;

/// What goes from a robot to a server at given times: requests that are answered, or bursts of datagrams that are not.
class Sender
{
  public:
    Sender(const Json& spec, Robot& robot, const Addresses& addresses, uint32_t number)
        : m_robot(robot),
          m_addresses(addresses),
          m_number(number),
          m_name(spec["name"].Text()),
          m_answered(spec.Has("answer_bytes"))
    {
        for (const Json& server : spec["servers"].Items())
        {
            m_servers.emplace_back(server.Items()[0].Number(), server.Items()[1].Text());
        }
        for (const Json& time : spec["times_s"].Items())
        {
            m_times.push_back(time.Number());
        }
        for (const Json& bytes : spec["datagrams"].Items())
        {
            m_datagrams.push_back(static_cast<uint32_t>(bytes.Number()));
        }
        if (m_answered)
        {
            m_answerBytes = static_cast<uint32_t>(spec["answer_bytes"].Number());
            m_processingUs = static_cast<uint32_t>(spec["processing_s"].Number() * 1e6);
            m_timeout = spec["timeout_s"].Number();
        }
    }

    void Start()
    {
        m_socket = Socket::CreateSocket(m_robot.node, UdpSocketFactory::GetTypeId());
        m_socket->Bind();
        m_socket->SetRecvCallback(MakeCallback(&Sender::Receive, this));
        SendNext();
    }

    /// Writes the times from request to answer, each behind the number of its request.
    void Write(std::ostream& out) const
    {
        out << "{\"name\":\"" << m_name << "\",\"sent\":" << m_next << ",\"took_s\":[";
        for (size_t i = 0; i < m_took.size(); ++i)
        {
            out << (i ? "," : "") << "[" << m_took[i].first << "," << m_took[i].second << "]";
        }
        out << "]}";
    }

  private:
    void SendNext()
    {
        if (m_next < m_times.size())
        {
            Simulator::Schedule(Seconds(m_times[m_next]) - Simulator::Now(), &Sender::Send, this);
        }
    }

    void Send()
    {
        const double now = Simulator::Now().GetSeconds();
        while (m_server + 1 < m_servers.size() && m_servers[m_server + 1].first <= now)
        {
            ++m_server;
        }
        auto to = m_addresses.find({m_robot.unit, m_servers[m_server].second});
        for (uint32_t bytes : m_datagrams)
        {
            if (to != m_addresses.end())
            {
                const Header header{m_number, m_next, m_answerBytes, m_processingUs};
                m_socket->SendTo(MakePacket(header, bytes), 0, InetSocketAddress(to->second, m_answered ? ANSWERS : TAKES));
            }
        }
        ++m_next;
        SendNext();
    }

    void Receive(Ptr<Socket> socket)
    {
        while (Ptr<Packet> packet = socket->Recv())
        {
            const Header header = ReadHeader(packet);
            const double took = Simulator::Now().GetSeconds() - m_times[header.sequence];
            if (took <= m_timeout)
            {
                m_took.emplace_back(header.sequence, took);
            }
        }
    }

    Robot& m_robot;
    const Addresses& m_addresses;
    uint32_t m_number;
    std::string m_name;
    bool m_answered;
    /// Server from each time on.
    std::vector<std::pair<double, std::string>> m_servers;
    size_t m_server = 0;
    std::vector<double> m_times;
    uint32_t m_next = 0;
    std::vector<uint32_t> m_datagrams;
    uint32_t m_answerBytes = 0;
    uint32_t m_processingUs = 0;
    double m_timeout = 0;
    Ptr<Socket> m_socket;
    std::vector<std::pair<uint32_t, double>> m_took;
};

using Senders = std::vector<std::unique_ptr<Sender>>;

/// Takes the datagrams of bursts that come to a server.
void
Take(Ptr<Socket> socket)
{
    while (socket->Recv())
    {
    }
}

/// Answers the requests that come to a server.
void
Answer(Ptr<Socket> socket)
{
    Address from;
    while (Ptr<Packet> packet = socket->RecvFrom(from))
    {
        const Header header = ReadHeader(packet);
        Simulator::Schedule(MicroSeconds(header.processingUs), [socket, header, from] {
            socket->SendTo(MakePacket(header, header.answerBytes), 0, from);
        });
    }
}

/// Traffic of a source from one node to another: UDP datagrams, or a TCP connection.
class Traffic
{
  public:
    Traffic(const Json& spec, Ptr<Node> from, Ptr<Node> to, uint16_t port)
        : m_spec(spec),
          m_from(from),
          m_to(to),
          m_port(port),
          m_isTcp(spec["protocol"].Text() == "tcp"),
          m_stop(Seconds(spec["stop_s"].Number()))
    {
        m_factory = m_isTcp ? TcpSocketFactory::GetTypeId() : UdpSocketFactory::GetTypeId();
        if (!m_isTcp)
        {
            m_size = static_cast<uint32_t>(spec["bytes"].Number());
        }
        else if (spec.Has("bytes"))
        {
            m_left = static_cast<uint64_t>(spec["bytes"].Number());
        }
    }

    /// Listens at once and sends from `start_s` on, to the address that `address` returns then.
    void Start(std::function<Ipv4Address()> address)
    {
        m_sink = Socket::CreateSocket(m_to, m_factory);
        m_sink->Bind(InetSocketAddress(Ipv4Address::GetAny(), m_port));
        m_sink->SetRecvCallback(MakeCallback(&Traffic::Receive, this));
        if (m_isTcp)
        {
            m_sink->Listen();
            m_sink->SetAcceptCallback(MakeNullCallback<bool, Ptr<Socket>, const Address&>(),
                                      MakeCallback(&Traffic::Accept, this));
        }
        const Time start = Seconds(m_spec["start_s"].Number());
        // Addresses and block acknowledgements are there before the traffic, as for robots that move already.
        const Time before = MilliSeconds(500 - 2 * (m_port - TRAFFIC) % 400);
        Simulator::Schedule(start - before, [this, address] {
            Ptr<Socket> first = Socket::CreateSocket(m_from, UdpSocketFactory::GetTypeId());
            first->SendTo(Create<Packet>(1), 0, InetSocketAddress(address(), DISCARD));
        });
        Simulator::Schedule(start, [this, address] { Begin(address()); });
    }

    void Write(std::ostream& out) const
    {
        out << "{\"name\":\"" << m_spec["name"].Text() << "\",\"sent\":" << m_sent << ",\"bytes\":" << m_bytes
            << ",\"last_s\":" << m_last.GetSeconds() << ",\"took_s\":[";
        for (size_t i = 0; i < m_took.size(); ++i)
        {
            out << (i ? "," : "") << m_took[i];
        }
        out << "]}";
    }

  private:
    /// Packets that a saturated source keeps waiting, as ours.
    static constexpr uint32_t BACKLOG = 128;

    void Begin(Ipv4Address to)
    {
        if (m_isTcp)
        {
            static const std::map<std::string, std::string> algorithms{{"reno", "ns3::TcpLinuxReno"},
                                                                       {"cubic", "ns3::TcpCubic"},
                                                                       {"bbr", "ns3::TcpBbr"}};
            const TypeId algorithm = TypeId::LookupByName(algorithms.at(m_spec["congestion_control"].Text()));
            m_from->GetObject<TcpL4Protocol>()->SetAttribute("SocketType", TypeIdValue(algorithm));
        }
        m_socket = Socket::CreateSocket(m_from, m_factory);
        m_socket->Bind();
        if (m_isTcp)
        {
            m_socket->SetConnectCallback(MakeCallback(&Traffic::Fill, this), MakeNullCallback<void, Ptr<Socket>>());
            m_socket->SetSendCallback(MakeCallback(&Traffic::FillMore, this));
        }
        m_socket->Connect(InetSocketAddress(to, m_port));
        if (!m_isTcp)
        {
            m_spec.Has("rate_bps") ? SendAtRate() : Saturate();
        }
    }

    /// Gives a connection all that it takes.
    void Fill(Ptr<Socket> socket)
    {
        while (m_left > 0 && Simulator::Now() < m_stop && socket->GetTxAvailable() > 0)
        {
            const int sent = socket->Send(Create<Packet>(std::min<uint64_t>(m_left, socket->GetTxAvailable())));
            if (sent <= 0)
            {
                return;
            }
            m_left -= sent;
        }
        if (m_left == 0)
        {
            socket->Close();
        }
    }

    void FillMore(Ptr<Socket> socket, uint32_t)
    {
        Fill(socket);
    }

    void Accept(Ptr<Socket> accepted, const Address&)
    {
        accepted->SetRecvCallback(MakeCallback(&Traffic::Receive, this));
    }

    void SendDatagram()
    {
        const Stamp stamp{Simulator::Now().GetNanoSeconds()};
        Ptr<Packet> packet = Create<Packet>(reinterpret_cast<const uint8_t*>(&stamp), sizeof(Stamp));
        packet->AddAtEnd(Create<Packet>(std::max<uint32_t>(m_size, sizeof(Stamp)) - sizeof(Stamp)));
        m_socket->Send(packet);
        ++m_sent;
    }

    void SendAtRate()
    {
        if (Simulator::Now() >= m_stop)
        {
            return;
        }
        SendDatagram();
        double interval = m_size * 8 / m_spec["rate_bps"].Number();
        if (m_spec["poisson"].Flag())
        {
            interval = m_draws->GetValue(interval, 0);
        }
        Simulator::Schedule(Seconds(interval), &Traffic::SendAtRate, this);
    }

    /// Looks each millisecond whether the queues of the node's interfaces want packets.
    void Saturate()
    {
        if (Simulator::Now() >= m_stop)
        {
            return;
        }
        Ptr<TrafficControlLayer> control = m_from->GetObject<TrafficControlLayer>();
        auto waiting = [&] {
            uint32_t packets = 0;
            for (uint32_t i = 0; i < m_from->GetNDevices(); ++i)
            {
                Ptr<NetDevice> device = m_from->GetDevice(i);
                Ptr<QueueDisc> queue = control->GetRootQueueDiscOnDevice(device);
                packets += queue ? queue->GetNPackets() : 0;
                if (Ptr<WifiNetDevice> radio = DynamicCast<WifiNetDevice>(device))
                {
                    const AcIndex category = radio->GetMac()->GetQosSupported() ? AC_BE : AC_BE_NQOS;
                    packets += radio->GetMac()->GetTxopQueue(category)->GetNPackets();
                }
            }
            return packets;
        };
        // A datagram that no queue keeps is lost, such as while the node looks for an address: one at a time.
        bool isTaken = true;
        for (uint32_t before = waiting(); isTaken && before < BACKLOG; ++before)
        {
            SendDatagram();
            isTaken = waiting() > before;
        }
        Simulator::Schedule(MilliSeconds(1), &Traffic::Saturate, this);
    }

    void Receive(Ptr<Socket> socket)
    {
        while (Ptr<Packet> packet = socket->Recv())
        {
            m_last = Simulator::Now();
            m_bytes += packet->GetSize();
            if (!m_isTcp)
            {
                Stamp stamp{};
                packet->CopyData(reinterpret_cast<uint8_t*>(&stamp), sizeof(Stamp));
                m_took.push_back((Simulator::Now() - NanoSeconds(stamp.sentNs)).GetSeconds());
            }
        }
    }

    /// The beginning of a datagram.
    struct Stamp
    {
        int64_t sentNs;
    };

    const Json& m_spec;
    Ptr<Node> m_from;
    Ptr<Node> m_to;
    uint16_t m_port;
    bool m_isTcp;
    Time m_stop;
    TypeId m_factory;
    Ptr<Socket> m_sink;
    Ptr<Socket> m_socket;
    Ptr<ExponentialRandomVariable> m_draws = CreateObject<ExponentialRandomVariable>();
    /// Bytes of a datagram's payload.
    uint32_t m_size = 0;
    /// Bytes that a connection has still to send.
    uint64_t m_left = std::numeric_limits<uint64_t>::max();
    uint64_t m_sent = 0;
    /// Bytes of payloads that arrived, and when the last did.
    uint64_t m_bytes = 0;
    Time m_last;
    /// Times from sender to receiver of datagrams, s.
    std::vector<double> m_took;
};

// ---------------------------------------------------------------------------------------------------------------- Air

WifiStandard
StandardOf(const std::string& name)
{
    static const std::map<std::string, WifiStandard> standards{{"g", WIFI_STANDARD_80211g},
                                                               {"a", WIFI_STANDARD_80211a},
                                                               {"n", WIFI_STANDARD_80211n},
                                                               {"ac", WIFI_STANDARD_80211ac},
                                                               {"ax", WIFI_STANDARD_80211ax}};
    return standards.at(name);
}

/// Loss over distance: `reference_db` of the sender's network at 1 m, and 10 n dB more for each tenfold distance beyond it.
class Loss : public PropagationLossModel
{
  public:
    void Add(Ptr<MobilityModel> place, const Json& network)
    {
        m_networks[place] = {network["reference_db"].Number(), network["exponent"].Number()};
    }

  private:
    double DoCalcRxPower(double txPowerDbm, Ptr<MobilityModel> from, Ptr<MobilityModel> to) const override
    {
        const auto& [reference, exponent] = m_networks.at(from);
        const double metres = std::max(from->GetDistanceFrom(to), NEAREST);
        // Nearer than 1 m, as in free space.
        const double decade = metres < 1 ? 20 : 10 * exponent;
        return txPowerDbm - reference - decade * std::log10(metres);
    }

    int64_t DoAssignStreams(int64_t) override { return 0; }

    static constexpr double NEAREST = 0.1;

    std::map<Ptr<MobilityModel>, std::pair<double, double>> m_networks;
};

/// What all networks share: their radios hear each other on the same channel number.
struct Air
{
    Ptr<Loss> loss = CreateObject<Loss>();
    Ptr<YansWifiChannel> channel = CreateObject<YansWifiChannel>();

    Air()
    {
        channel->SetPropagationLossModel(loss);
        channel->SetPropagationDelayModel(CreateObject<ConstantSpeedPropagationDelayModel>());
    }
};

/// A wireless network: what its radios have in common.
class Network
{
  public:
    Network(const Json& spec, const Air& air)
        : m_spec(spec),
          m_air(air)
    {
    }

    /// Makes the radio of a node on a channel of this network. `isUnit` says whether it is a radio unit.
    Ptr<NetDevice> Install(Ptr<Node> node, const Json& unit, double txPowerDbm, bool isUnit) const
    {
        m_air.loss->Add(node->GetObject<MobilityModel>(), m_spec);
        const std::string standard = m_spec["standard"].Text();
        YansWifiPhyHelper phy;
        phy.SetChannel(m_air.channel);
        phy.SetErrorRateModel("ns3::NistErrorRateModel");
        std::ostringstream settings;
        settings << "{" << unit["channel"].Number() << ", " << m_spec["width_mhz"].Number() << ", "
                 << (m_spec["is_5ghz"].Flag() ? "BAND_5GHZ" : "BAND_2_4GHZ") << ", "
                 << unit["primary"].Number() << "}";
        phy.Set("ChannelSettings", StringValue(settings.str()));
        phy.Set("TxPowerStart", DoubleValue(txPowerDbm));
        phy.Set("TxPowerEnd", DoubleValue(txPowerDbm));
        phy.Set("RxNoiseFigure", DoubleValue(m_spec["noise_figure_db"].Number()));
        // Weakest frames that a receiver finds, and for which a sender waits.
        const double sensitivity = m_spec["sensitivity_dbm"].Number();
        phy.Set("RxSensitivity", DoubleValue(sensitivity));
        phy.Set("CcaSensitivity", DoubleValue(sensitivity));
        phy.SetPreambleDetectionModel("ns3::ThresholdPreambleDetectionModel",
                                      "MinimumRssi",
                                      DoubleValue(sensitivity),
                                      "Threshold",
                                      DoubleValue(0));
        const uint8_t streams = static_cast<uint8_t>(m_spec["streams"].Number());
        phy.Set("Antennas", UintegerValue(streams));
        phy.Set("MaxSupportedTxSpatialStreams", UintegerValue(streams));
        phy.Set("MaxSupportedRxSpatialStreams", UintegerValue(streams));

        WifiHelper wifi;
        wifi.SetStandard(StandardOf(standard));
        const bool isHt = standard != "a" && standard != "g";
        if (m_spec.Has("mode"))
        {
            // RTS, if there were any, at the lowest basic rate. Answers follow the data's modulation on both sides.
            wifi.SetRemoteStationManager("ns3::ConstantRateWifiManager",
                                         "DataMode",
                                         StringValue(m_spec["mode"].Text()),
                                         "ControlMode",
                                         StringValue(m_spec["is_5ghz"].Flag() ? "OfdmRate6Mbps" : "ErpOfdmRate6Mbps"));
        }
        else if (m_spec["rate_control"].Text() == "ideal")
        {
            wifi.SetRemoteStationManager("ns3::IdealWifiManager");
        }
        else
        {
            wifi.SetRemoteStationManager(isHt ? "ns3::MinstrelHtWifiManager" : "ns3::MinstrelWifiManager");
        }
        WifiMacHelper mac;
        const Ssid ssid(unit["name"].Text());
        if (isUnit)
        {
            mac.SetType("ns3::ApWifiMac", "Ssid", SsidValue(ssid));
        }
        else
        {
            mac.SetType("ns3::StaWifiMac", "Ssid", SsidValue(ssid), "ActiveProbing", BooleanValue(false));
        }
        NetDeviceContainer devices = wifi.Install(phy, mac, node);
        Ptr<WifiNetDevice> device = DynamicCast<WifiNetDevice>(devices.Get(0));
        const Time guardInterval = NanoSeconds(static_cast<uint64_t>(m_spec["guard_interval_ns"].Number()));
        if (auto ht = device->GetHtConfiguration())
        {
            ht->m_sgiSupported = guardInterval < NanoSeconds(800);
        }
        if (auto he = device->GetHeConfiguration())
        {
            he->SetGuardInterval(guardInterval);
        }
        // ns-3 bounds it by the standard. Its default is that of 802.11n.
        const uint32_t longest = m_spec["aggregation"].Flag() ? 6500631 : 0;
        device->GetMac()->SetAttribute("BE_MaxAmpduSize", UintegerValue(longest));
        return device;
    }

  private:
    const Json& m_spec;
    const Air& m_air;
};

// --------------------------------------------------------------------------------------------------------------- Wires

void
SetQueue(Ptr<NetDevice> device, const Json& queue)
{
    static const std::map<std::string, std::string> disciplines{{"drop_tail", "ns3::FifoQueueDisc"},
                                                                {"codel", "ns3::CoDelQueueDisc"},
                                                                {"fq_codel", "ns3::FqCoDelQueueDisc"},
                                                                {"pie", "ns3::PieQueueDisc"},
                                                                {"red", "ns3::RedQueueDisc"}};
    std::ostringstream limit;
    limit << static_cast<uint64_t>(queue["limit"].Number()) << (queue["in_bytes"].Flag() ? "B" : "p");
    TrafficControlHelper control;
    control.SetRootQueueDisc(disciplines.at(queue["discipline"].Text()), "MaxSize", StringValue(limit.str()));
    Ptr<QueueDisc> installed = control.Install(device).Get(0);
    for (const auto& [name, value] : queue["attributes"].Fields())
    {
        installed->SetAttribute(name, StringValue(value.Text()));
    }
}

/// Both ends of a wire.
struct Wire
{
    NetDeviceContainer devices;
    Ipv4InterfaceContainer interfaces;
};

Vector
PlaceOf(const Json& place)
{
    return Vector(place.Items()[0].Number(), place.Items()[1].Number(), place.Items()[2].Number());
}

void
Place(Ptr<Node> node, const Json& places)
{
    Ptr<WaypointMobilityModel> mobility = CreateObject<WaypointMobilityModel>();
    node->AggregateObject(mobility);
    for (const Json& place : places.Items())
    {
        const auto& numbers = place.Items();
        const Vector at(numbers[1].Number(), numbers[2].Number(), numbers[3].Number());
        mobility->AddWaypoint(Waypoint(Seconds(numbers[0].Number()), at));
    }
}

int
Run(const std::string& path, uint32_t seed)
{
    std::ifstream file(path);
    std::stringstream text;
    text << file.rdbuf();
    const Json scenario = Json::Read(text.str());
    RngSeedManager::SetSeed(1);
    RngSeedManager::SetRun(seed);
    Config::SetDefault("ns3::WifiRemoteStationManager::RtsCtsThreshold", UintegerValue(4692480));
    // The queue of a radio, by category. Nothing leaves it by its age.
    const uint64_t queued = static_cast<uint64_t>(scenario["radio_queue"].Number());
    Config::SetDefault("ns3::WifiMacQueue::MaxSize", QueueSizeValue(QueueSize(PACKETS, queued)));
    Config::SetDefault("ns3::WifiMacQueue::MaxDelay", TimeValue(Seconds(10)));
    // Linux sends the frames again; it does not ask first which of them arrived.
    Config::SetDefault("ns3::QosTxop::UseExplicitBarAfterMissedBlockAck", BooleanValue(false));
    // As Linux's neighbours that stay reachable: no request for an address in the middle of a run.
    Config::SetDefault("ns3::ArpCache::AliveTimeout", TimeValue(Seconds(100000)));
    // As ours: segments of a path of 1500 bytes with time stamps, and a receiver's window of 6 MiB.
    Config::SetDefault("ns3::TcpSocket::SegmentSize", UintegerValue(1448));
    Config::SetDefault("ns3::TcpSocket::InitialCwnd", UintegerValue(10));
    Config::SetDefault("ns3::TcpSocket::SndBufSize", UintegerValue(6 << 20));
    Config::SetDefault("ns3::TcpSocket::RcvBufSize", UintegerValue(6 << 20));

    InternetStackHelper internet;
    std::map<std::string, Ptr<Node>> nodes;
    auto node = [&](const std::string& name) {
        Ptr<Node>& node = nodes[name];
        if (!node)
        {
            node = CreateObject<Node>();
            internet.Install(node);
        }
        return node;
    };

    // Wires, from the radio units on.
    std::map<std::pair<std::string, std::string>, Wire> wires;
    Ipv4AddressHelper wired("10.0.0.0", "255.255.255.252");
    for (const Json& spec : scenario["wires"].Items())
    {
        PointToPointHelper helper;
        helper.SetDeviceAttribute("DataRate", DataRateValue(DataRate(static_cast<uint64_t>(spec["rate_bps"].Number()))));
        helper.SetChannelAttribute("Delay", TimeValue(Seconds(spec["delay_s"].Number())));
        helper.SetQueue("ns3::DropTailQueue<Packet>", "MaxSize", StringValue("1p"));
        const std::string a = spec["ends"].Items()[0].Text();
        const std::string b = spec["ends"].Items()[1].Text();
        Wire wire;
        wire.devices = helper.Install(node(a), node(b));
        SetQueue(wire.devices.Get(0), spec["queue"]);
        SetQueue(wire.devices.Get(1), spec["queue"]);
        wire.interfaces = wired.Assign(wire.devices);
        wired.NewNetwork();
        wires[{a, b}] = wire;
        Wire back;
        back.devices.Add(wire.devices.Get(1));
        back.devices.Add(wire.devices.Get(0));
        back.interfaces.Add(wire.interfaces.Get(1));
        back.interfaces.Add(wire.interfaces.Get(0));
        wires[{b, a}] = back;
    }

    // The air.
    const Air air;
    std::map<std::string, std::unique_ptr<Network>> networks;
    for (const Json& spec : scenario["networks"].Items())
    {
        networks[spec["name"].Text()] = std::make_unique<Network>(spec, air);
    }
    std::map<Ipv4Address, Robot*> owners;
    std::map<std::string, const Json*> unitSpecs;
    std::map<std::string, Ipv4Address> unitAddresses;
    std::map<std::string, Ipv4AddressHelper> cells;
    std::map<std::string, Ipv4Address> cellNetworks;
    uint32_t cell = 0;
    for (const Json& spec : scenario["radio_units"].Items())
    {
        const std::string name = spec["name"].Text();
        unitSpecs[name] = &spec;
        Ptr<Node> unit = node(name);
        Ptr<ConstantPositionMobilityModel> mobility = CreateObject<ConstantPositionMobilityModel>();
        mobility->SetPosition(PlaceOf(spec["position"]));
        unit->AggregateObject(mobility);
        Ptr<NetDevice> device = networks.at(spec["network"].Text())->Install(unit, spec, spec["tx_power_dbm"].Number(), true);
        const Ipv4Address network((11U << 24) + (cell++ << 16));
        cellNetworks[name] = network;
        cells[name] = Ipv4AddressHelper(network, Ipv4Mask("255.255.0.0"));
        unitAddresses[name] = cells[name].Assign(NetDeviceContainer(device)).GetAddress(0);
        TrafficControlHelper().Uninstall(device);
        unit->GetObject<Ipv4L3Protocol>()->TraceConnectWithoutContext(
            "Rx", Callback<void, Ptr<const Packet>, Ptr<Ipv4>, uint32_t>([&owners](Ptr<const Packet> packet, Ptr<Ipv4>, uint32_t) {
                Ipv4Header header;
                packet->PeekHeader(header);
                auto owner = owners.find(header.GetSource());
                if (owner != owners.end())
                {
                    owner->second->bytes += packet->GetSize() + ETHERNET;
                }
            }));
    }

    // The paths from radio units to servers, and back.
    Ipv4StaticRoutingHelper routing;
    Addresses addresses;
    for (const Json& spec : scenario["paths"].Items())
    {
        std::vector<std::string> path;
        for (const Json& name : spec.Items())
        {
            path.push_back(name.Text());
        }
        const size_t last = path.size() - 1;
        const Wire& end = wires.at({path[last - 1], path[last]});
        const Ipv4Address server = end.interfaces.GetAddress(1);
        addresses[{path[0], path[last]}] = server;
        for (size_t i = 0; i < last; ++i)
        {
            const Wire& wire = wires.at({path[i], path[i + 1]});
            const auto [here, in] = wire.interfaces.Get(0);
            const auto [there, out] = wire.interfaces.Get(1);
            if (i + 1 < last)
            {
                routing.GetStaticRouting(here)->AddHostRouteTo(server, wire.interfaces.GetAddress(1), in);
            }
            // Back to the stations of a radio unit, or to a server at the beginning of the path.
            auto cell = cellNetworks.find(path[0]);
            if (cell != cellNetworks.end())
            {
                routing.GetStaticRouting(there)->AddNetworkRouteTo(
                    cell->second, Ipv4Mask("255.255.0.0"), wire.interfaces.GetAddress(0), out);
            }
            else if (i > 0)
            {
                const Ipv4Address first = wires.at({path[0], path[1]}).interfaces.GetAddress(0);
                routing.GetStaticRouting(there)->AddHostRouteTo(first, wire.interfaces.GetAddress(0), out);
            }
        }
    }

    // Robots.
    std::map<std::string, Robot> robots;
    std::map<std::string, Ipv4Address> robotAddresses;
    for (const Json& spec : scenario["robots"].Items())
    {
        const std::string name = spec["name"].Text();
        Robot& robot = robots[name];
        robot.node = node(name);
        robot.node->GetObject<Ipv4>()->SetAttribute("IpForward", BooleanValue(false));
        Place(robot.node, spec["places"]);
        std::map<std::string, uint32_t> interfaces;
        for (const Json& attachment : spec["attachments"].Items())
        {
            const std::string unit = attachment.Items()[1].Text();
            if (!interfaces.count(unit))
            {
                const Json& unitSpec = *unitSpecs.at(unit);
                Ptr<NetDevice> device = networks.at(unitSpec["network"].Text())
                                            ->Install(robot.node, unitSpec, spec["tx_power_dbm"].Number(), false);
                auto assigned = cells.at(unit).Assign(NetDeviceContainer(device));
                TrafficControlHelper().Uninstall(device);
                interfaces[unit] = assigned.Get(0).second;
                owners[assigned.GetAddress(0)] = &robot;
                // A robot with sources of traffic has one radio unit only.
                robotAddresses[name] = assigned.GetAddress(0);
            }
            Simulator::Schedule(Seconds(attachment.Items()[0].Number()), [&robot, &routing, &unitAddresses, unit, interfaces] {
                Ptr<Ipv4StaticRouting> own = routing.GetStaticRouting(robot.node->GetObject<Ipv4>());
                for (uint32_t i = own->GetNRoutes(); i-- > 0;)
                {
                    if (own->GetRoute(i).IsDefault())
                    {
                        own->RemoveRoute(i);
                    }
                }
                own->SetDefaultRoute(unitAddresses.at(unit), interfaces.at(unit));
                robot.unit = unit;
            });
        }
    }

    // What robots send.
    Senders senders;
    const double until = scenario["until_s"].Number();
    for (const Json& spec : scenario["senders"].Items())
    {
        const uint32_t number = static_cast<uint32_t>(senders.size());
        senders.push_back(std::make_unique<Sender>(spec, robots.at(spec["robot"].Text()), addresses, number));
        senders.back()->Start();
    }
    for (const Json& name : scenario["servers"].Items())
    {
        for (uint16_t port : {ANSWERS, TAKES})
        {
            Ptr<Socket> socket = Socket::CreateSocket(node(name.Text()), UdpSocketFactory::GetTypeId());
            socket->Bind(InetSocketAddress(Ipv4Address::GetAny(), port));
            socket->SetRecvCallback(MakeCallback(port == ANSWERS ? &Answer : &Take));
        }
    }

    std::vector<std::unique_ptr<Traffic>> traffic;
    for (const Json& spec : scenario["traffic"].Items())
    {
        const std::string from = spec["from"].Text();
        const std::string to = spec["to"].Text();
        traffic.push_back(std::make_unique<Traffic>(spec, node(from), node(to), TRAFFIC + traffic.size()));
        traffic.back()->Start([&robots, &robotAddresses, &addresses, from, to] {
            auto receiver = robotAddresses.find(to);
            auto sender = robots.find(from);
            return receiver != robotAddresses.end()
                       ? receiver->second
                       : addresses.at({sender == robots.end() ? from : sender->second.unit, to});
        });
    }

    Simulator::Stop(Seconds(until));
    Simulator::Run();
    std::cout << std::setprecision(9) << "{\"senders\":[";
    for (size_t i = 0; i < senders.size(); ++i)
    {
        std::cout << (i ? "," : "");
        senders[i]->Write(std::cout);
    }
    std::cout << "],\"traffic\":[";
    for (size_t i = 0; i < traffic.size(); ++i)
    {
        std::cout << (i ? "," : "");
        traffic[i]->Write(std::cout);
    }
    std::cout << "],\"robots\":[";
    for (auto robot = robots.begin(); robot != robots.end(); ++robot)
    {
        std::cout << (robot == robots.begin() ? "" : ",") << "{\"name\":\"" << robot->first << "\",\"bytes\":" << robot->second.bytes
                  << "}";
    }
    std::cout << "]}\n";
    Simulator::Destroy();
    return 0;
}

} // namespace

int
main(int count, char** arguments)
{
    if (count != 3)
    {
        std::cerr << "usage: scenario SCENARIO.json SEED\n";
        return 2;
    }
    try
    {
        return Run(arguments[1], static_cast<uint32_t>(std::stoul(arguments[2])));
    }
    catch (const std::exception& error)
    {
        std::cerr << "scenario: " << error.what() << "\n";
        return 1;
    }
}
