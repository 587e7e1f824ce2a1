// Prints airtimes of PPDUs and error rates of PSDUs as ns-3 3.44 has them. ns-3 is not linked into cotorra: this makes the
// table beside it again.
//
//   NS3=$(python -c 'import ns3, pathlib; print(pathlib.Path(ns3.__path__[0]))')
//   g++ -std=c++23 -O2 -I "$NS3/include" rates.cc -L "$NS3/lib64" -Wl,-rpath,"$NS3/lib64" \
//       -lns3.44-core -lns3.44-network -lns3.44-wifi -o rates && ./rates > rates.txt
#include "ns3/core-module.h"
#include "ns3/he-phy.h"
#include "ns3/ht-phy.h"
#include "ns3/nist-error-rate-model.h"
#include "ns3/ofdm-phy.h"
#include "ns3/vht-phy.h"
#include "ns3/wifi-phy.h"
#include "ns3/wifi-tx-vector.h"

#include <cmath>
#include <cstdio>
#include <string>

using namespace ns3;

struct Kind
{
    const char* name;
    WifiPreamble preamble;
    int mostMcs;
    int mostWidth;
};

static WifiMode
ModeOf(const Kind& kind, int mcs, int streams)
{
    switch (kind.preamble)
    {
    case WIFI_PREAMBLE_HT_MF:
        return HtPhy::GetHtMcs(mcs + 8 * (streams - 1));
    case WIFI_PREAMBLE_VHT_SU:
        return VhtPhy::GetVhtMcs(mcs);
    default:
        return HePhy::GetHeMcs(mcs);
    }
}

int
main()
{
    const Kind kinds[] = {{"n", WIFI_PREAMBLE_HT_MF, 7, 40},
                          {"ac", WIFI_PREAMBLE_VHT_SU, 9, 80},
                          {"ax", WIFI_PREAMBLE_HE_SU, 11, 80}};
    for (const auto& kind : kinds)
    {
        const bool he = kind.preamble == WIFI_PREAMBLE_HE_SU;
        for (int band : {2, 5})
        {
            if (band == 2 && kind.preamble == WIFI_PREAMBLE_VHT_SU)
                continue;
            for (int width = 20; width <= (band == 2 ? 40 : kind.mostWidth); width *= 2)
                for (int streams = 1; streams <= 2; streams++)
                    for (int guard : he ? std::vector{800, 1600, 3200} : std::vector{400, 800})
                        for (int mcs = 0; mcs <= kind.mostMcs; mcs++)
                        {
                            // VHT-MCS 9 needs whole bits in a symbol, which 20 MHz do not have with one or two streams.
                            if (!he && mcs == 9 && width == 20)
                                continue;
                            for (int bytes : {1500, 30000})
                            {
                                const auto mode = ModeOf(kind, mcs, streams);
                                WifiTxVector vector(mode, 1, kind.preamble, NanoSeconds(guard), 2, streams, 0,
                                                    MHz_u(width), true);
                                const auto time = WifiPhy::CalculateTxDuration(
                                    bytes, vector, band == 2 ? WIFI_PHY_BAND_2_4GHZ : WIFI_PHY_BAND_5GHZ);
                                std::printf("airtime %s %d %d %d %d %d %d %ld\n", kind.name, band, width, streams,
                                            guard, mcs, bytes, (long)time.GetNanoSeconds());
                            }
                        }
        }
    }
    // Shares of PSDUs of 1500 bytes that are lost, by signal-to-noise ratio.
    auto nist = CreateObject<NistErrorRateModel>();
    for (int mcs = 0; mcs <= 11; mcs++)
    {
        const auto mode = HePhy::GetHeMcs(mcs);
        WifiTxVector vector(mode, 1, WIFI_PREAMBLE_HE_SU, NanoSeconds(800), 1, 1, 0, MHz_u(20), false);
        for (int half = 0; half <= 90; half++)
        {
            const double snr = std::pow(10.0, half / 20.0);
            const double lost = 1.0 - nist->GetChunkSuccessRate(mode, vector, snr, 8 * 1500);
            if (lost > 1e-4 && lost < 1 - 1e-4)
                std::printf("lost %d %.1f %.6f\n", mcs, half / 2.0, lost);
        }
    }
}
