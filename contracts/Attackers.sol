// SPDX-License-Identifier: MIT OR Apache-2.0
pragma solidity 0.8.37;

/// Contracts that mean no good, for the tests of Federation.sol.

/// A wallet that does what its owner says: the attackers are operators, too.
contract Wallet {
    function execute(address target, bytes calldata input) external payable {
        (bool done, bytes memory answer) = target.call{value: msg.value}(input);
        if (!done) {
            assembly {
                revert(add(answer, 32), mload(answer))
            }
        }
    }
}

/// When it is paid, it asks for the money once more.
contract Reentrant is Wallet {
    /// How often a call from within the payment went through.
    uint256 public gains;
    /// What is called from within the payment.
    bytes public again;

    function setAgain(bytes calldata input) external {
        again = input;
    }

    receive() external payable {
        (bool done,) = msg.sender.call(again);
        if (done) gains += 1;
    }
}

/// It takes no money.
contract Unpayable is Wallet {
    receive() external payable {
        revert();
    }
}
