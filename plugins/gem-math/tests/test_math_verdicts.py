r"""The verdicts: hundreds of answers with the verdict that each deserves, form by form.

Each line is a gold answer, then answers that are right, then answers that are wrong. All are graded in both plain and
boxed writing. They were written for this project, with the known failures of public graders in mind.
"""

# ruff: noqa: E501  # a table: one line for each gold answer and its right and its wrong answers

from __future__ import annotations

import pytest

from gem_math.grading import grade

# fmt: off
CASES: list[tuple[str, list[str], list[str]]] = [
    # Whole numbers, and their separators
    ("18", ["18", "18.0", "18.", "+18", "018", " 18 ", "$18$", "\\(18\\)", "\\[18\\]", "18.000", "{18}", "(18)", "9+9",
            "2\\cdot 9", "36/2", "\\text{18}", "\\mathbf{18}", "**18**", "x=18", "= 18", "18 apples", "18 \\text{ eggs}",
            "\\$18", "$18", "18 dollars", "18\\%", "\\textbf{18}", "18!/17!", "eighteen", "\\boxed{18}", "x = 9 + 9 = 18"],
           ["-18", "180", "81", "1", "8", "118", "18.5", "18,19", "17, 18", "18 or 19", "\\{18, 19\\}", "(18, 19)",
            "18 million", "not 18", "18x", "x", "", "18 is wrong", "I do not know", "18 \\text{ or } 20", "\\pm 18",
            "x > 18", "x \\ne 18", "1 8", "0x12", "18^\\circ 30'", "0.18", "18_3", "18i", "\\text{not } 18", "18, maybe 19"]),
    ("1,000", ["1000", "1,000", "1{,}000", "1\\,000", "1 000", "10^3", "10^{3}", "1000.00", "\\$1,000", "1.0\\times 10^3",
               "1 \\cdot 10^{3}", "1 thousand"],
              ["1", "1.000", "100", "10000", "1, 0, 0, 0", "(1, 1000)", "0", "1,001", "1000,000"]),
    ("2125", ["2,125", "2125.0", "\\$2{,}125"], ["2.125", "21250", "212", "5", "2, 126", "(2,126)"]),
    ("1450000", ["1,450,000", "1.45 \\times 10^6", "1.45 million", "1{,}450{,}000", "1\\!450\\!000"],
                ["1,450", "1.45", "145000", "1.45 \\times 10^5", "1.45 billion"]),
    ("-10", ["-10", "−10", "- 10", "-10.0", "-\\frac{20}{2}", "0-10", "\\text{-10}"], ["10", "--10", "-1", "+10", "\\pm 10"]),
    ("0", ["0", "0.0", "-0", "\\frac{0}{5}", "5-5", "\\sin(0)", "\\sin \\pi", "zero", "x = 0"],
          ["1", "\\emptyset", "none", "10^{-10}", "0.0000001", "o", "\\frac{1}{10^{20}}", "\\{\\}"]),
    ("27.0", ["27", "27.0", "27.00", "\\frac{54}{2}"], ["27.1", "270", "2.7", "26.999999", "27.0000001"]),
    ("025", ["25", "025", "25.0"], ["2", "5", "0.25", "250"]),
    # Fractions and decimals
    ("\\frac{1}{2}", ["1/2", "0.5", ".5", "\\frac12", "\\dfrac{1}{2}", "\\tfrac12", "\\cfrac{1}{2}", "\\frac{2}{4}", "50\\%",
                      "½", "2^{-1}", "0.50", "\\frac{-1}{-2}", "1\\div 2", "\\left(\\frac{1}{2}\\right)", "\\frac1{2}",
                      "\\frac{1}2", "1:2", "\\sin 30^\\circ", "\\frac{\\sqrt{4}}{4}", "y=\\frac{1}{2}", "P = 0.5"],
                     ["2", "1", "0.51", "0.49", "\\frac{1}{3}", "-\\frac{1}{2}", "\\frac{2}{1}", "12", "1, 2", "(1,2)",
                      "1/2/2", "0.5x", "0,6", "5", "\\frac{1}{2}x", "2:1", "1 \\text{ of } 3", "1/2 or 1/3"]),
    ("\\frac{1}{3}", ["1/3", "\\frac{2}{6}", "0.333333", "0.3333333", "3^{-1}"],
                     ["0.33", "0.3", "0.333", "0.3334", "0.34", "33\\%", "3", "\\frac{1}{30}", "0.333343"]),
    ("\\frac{22}{7}", ["22/7", "3\\frac{1}{7}", "3 1/7", "\\frac{44}{14}"], ["3.14", "\\pi", "3.142", "\\frac{7}{22}", "3/7"]),
    ("3\\frac{1}{2}", ["7/2", "3.5", "3 \\frac{1}{2}", "\\frac{7}{2}", "3½", "3 1/2"], ["3/2", "1.5", "31/2", "15.5", "3, 1/2"]),
    ("-2\\frac{1}{4}", ["-9/4", "-2.25", "-\\frac{9}{4}"], ["-7/4", "-1.75", "-0.5", "2.25"]),
    ("0.75", ["3/4", ".75", "0.750", "75\\%", "\\frac{3}{4}", "7.5\\times 10^{-1}"], ["0.7", "0.76", "75", "0.075", "7.5"]),
    ("0.125", ["1/8", "12.5\\%", ".1250"], ["0.12", "0.13", "1.25", "0.1250001"]),
    ("3.14", ["3.14", "3.140", "314/100"], ["\\pi", "22/7", "3.1", "3.1416", "3.14159"]),
    ("16386.20", ["16386.2", "\\$16,386.20", "\\$16{,}386.20", "16,\\!386.20"], ["16386", "16386.02", "1638.62", "16386.21"]),
    ("1.5\\times 10^{-3}", ["0.0015", "1.5 \\cdot 10^{-3}", "15\\times10^{-4}", "\\frac{3}{2000}"], ["1.5\\times 10^{3}", "1.5", "0.015"]),
    ("2^{1009}", ["2^{1009}", "2\\cdot 2^{1008}", "4^{504}\\cdot 2"], ["2^{1008}", "2^{1010}", "1009", "2009", "2^{1009}+1"]),
    ("\\frac{100!}{2^{50}}", ["100!/2^{50}", "\\frac{100!}{4^{25}}"], ["100!", "\\frac{100!}{2^{49}}", "\\frac{100!}{2^{50}}+1"]),
    ("10^{100}", ["10^{100}", "100^{50}", "(10^{10})^{10}"], ["10^{10}", "100", "10^{100}+1", "10^{101}"]),
    # Per cent
    ("25\\%", ["25\\%", "25%", "25 %", "25", "0.25", "1/4", "25 percent", "25\\text{ percent}", "25 \\text{ per cent}", "\\frac14"],
              ["2.5", "0.025", "75\\%", "25.5\\%", "250\\%", "2500", "0.26"]),
    ("50", ["50\\%", "50%", "50", "50 percent"], ["0.5", "5\\%", "500\\%", "1/2"]),
    ("0.08", ["8\\%", "0.08", "2/25", "8 \\%"], ["8", "0.8", "80\\%", "0.8\\%"]),
    ("62.5%", ["62.5", "62.5\\%", "5/8", "0.625"], ["62", "62.5/1000", "625", "37.5\\%", "0.0625"]),
    # Units, money, angles, times
    ("5\\text{ cm}", ["5", "5 cm", "5cm", "5\\,\\text{cm}", "5 \\mathrm{cm}", "5 centimeters", "50 mm", "0.05 \\text{ m}", "x=5\\text{ cm}"],
                     ["5 m", "5 mm", "5 \\text{ cm}^2", "5 kg", "6 cm", "50 cm", "5 \\text{ seconds}"]),
    ("12\\text{ cm}^2", ["12", "12 cm^2", "12 \\text{ square centimeters}", "12\\text{ sq cm}", "12 cm²", "12\\,\\text{cm}^{2}", "1200 \\text{ mm}^2"],
                        ["12 cm", "12 \\text{ cm}^3", "12 \\text{ m}^2", "144", "120 \\text{ mm}^2"]),
    ("60", ["60 km/h", "60 \\text{ km/h}", "60\\text{ mph}", "60 \\text{ miles per hour}", "60 minutes", "60^\\circ", "60°", "60 degrees", "60 m", "60 \\text{ square units}", "60 \\text{ units}"],
           ["60 thousand", "1 \\text{ hour}", "6", "60^2", "60 \\text{ or } 61"]),
    ("90^\\circ", ["90", "90°", "90 degrees", "90^{\\circ}", "90\\text{ degrees}", "\\frac{\\pi}{2}", "\\angle A = 90^\\circ"], ["9", "90\\pi", "\\pi", "180", "90 \\text{ radians}", "1.57"]),
    ("\\frac{\\pi}{4}", ["\\pi/4", "45^\\circ", "0.25\\pi", "\\frac{1}{4}\\pi", "π/4", "\\frac{3\\pi}{12}"], ["45", "\\frac{\\pi}{2}", "0.785", "4/\\pi", "\\frac{\\pi}{4} + 2\\pi", "46^\\circ"]),
    ("\\$5", ["5", "$5", "\\$5.00", "5 dollars", "5 \\text{ dollars}", "USD 5", "500 \\text{ cents}", "\\$ 5"], ["5 \\text{ cents}", "\\$50", "€5", "\\$0.05", "-\\$5"]),
    ("50\\text{ cents}", ["50", "\\$0.50", "50 cents", "0.5 \\text{ dollars}"], ["\\$50", "5 \\text{ cents}", "500 \\text{ cents}"]),
    ("2 \\text{ hours}", ["2", "2 h", "120 \\text{ minutes}", "2 hours", "2\\text{ hr}", "7200 \\text{ seconds}"], ["2 \\text{ minutes}", "2 \\text{ days}", "20 hours", "121 minutes"]),
    ("5\\text{ feet}", ["5", "5 ft", "60 inches", "5\\text{ ft}"], ["5 inches", "6 feet", "5 \\text{ yards}"]),
    ("3 \\text{ apples}", ["3", "3 apples", "3 \\text{ apples}", "three"], ["3 \\text{ oranges}", "4 \\text{ apples}", "3 \\text{ cm}"]),
    ("7 \\text{ million}", ["7000000", "7,000,000", "7\\times 10^6", "7 million"], ["7", "7 \\text{ billion}", "700000"]),
    ("4^{\\circ}", ["4", "4°", "4^\\circ"], ["40^\\circ", "-4^\\circ", "4\\text{ cm}"]),
    ("6m", ["6m", "6 m", "m\\cdot 6", "2m+4m"], ["6", "6n", "m", "6m^2", "6\\text{ cm}"]),
    # Roots, powers, logarithms, constants
    ("2\\sqrt{3}", ["\\sqrt{12}", "2\\sqrt3", "2√3", "\\sqrt{3}\\cdot 2", "\\frac{6}{\\sqrt{3}}", "2*sqrt(3)", "\\sqrt{4\\cdot 3}", "3.464101615" , "12^{1/2}", "2\\cdot 3^{0.5}"],
                  ["\\sqrt{6}", "2+\\sqrt{3}", "3\\sqrt{2}", "\\sqrt{3}", "3.46", "12", "2\\sqrt{3}x", "-2\\sqrt{3}", "\\pm 2\\sqrt{3}", "2\\sqrt[3]{3}"]),
    ("\\frac{\\sqrt{2}}{2}", ["\\frac{1}{\\sqrt{2}}", "\\sqrt{\\frac12}", "\\sqrt{0.5}", "\\frac12\\sqrt2", "\\cos 45^\\circ", "\\sin\\frac{\\pi}{4}", "2^{-1/2}"],
                           ["\\sqrt{2}", "\\frac{\\sqrt{2}}{4}", "0.707", "\\frac{2}{\\sqrt 2}", "\\frac{\\sqrt{3}}{2}"]),
    ("\\frac{-1+\\sqrt{5}}{2}", ["\\frac{\\sqrt5-1}{2}", "\\frac{2}{1+\\sqrt{5}}", "0.5(\\sqrt5-1)", "(\\sqrt{5}-1)/2"], ["\\frac{1+\\sqrt{5}}{2}", "0.618", "\\frac{-1-\\sqrt5}{2}", "\\frac{-1\\pm\\sqrt5}{2}", "-1+\\sqrt{5}/2"]),
    ("5\\sqrt[3]{4}", ["5\\cdot 4^{1/3}", "\\sqrt[3]{500}", "5\\cdot 2^{2/3}"], ["5\\sqrt{4}", "10", "5\\sqrt[4]{3}", "\\sqrt[3]{20}"]),
    ("4\\pi^2-1", ["4\\pi^{2}-1", "(2\\pi-1)(2\\pi+1)", "-1+4\\pi^2"], ["4\\pi-1", "4\\pi^2+1", "38.478", "(2\\pi-1)^2"]),
    ("\\log_2 10", ["\\log_{2}10", "\\frac{\\ln 10}{\\ln 2}", "1+\\log_2 5", "\\frac{1}{\\lg 2}" , "\\frac{\\log 10}{\\log 2}"], ["\\log_{10} 2", "\\ln 10", "10", "3.32", "\\log 10"]),
    ("\\frac{\\log 2}{\\log 2-\\log 3}", ["\\frac{\\ln 2}{\\ln 2-\\ln 3}", "\\frac{\\log 2}{\\log(2/3)}"], ["\\frac{\\log 2}{\\log 3}", "-1.7", "\\log 2"]),
    ("e^2", ["e^{2}", "e\\cdot e", "\\exp(2)"], ["2e", "7.389", "e^3", "2^e", "x^2"]),
    ("1+i", ["i+1", "\\frac{2}{1-i}", "1+1i"], ["1-i", "1", "i", "\\sqrt{2}"]),
    ("-3i", ["-3i", "\\frac{3}{i}", "0-3i"], ["3i", "-3", "i^3"]),
    ("\\binom{10}{3}", ["120", "\\frac{10!}{3!7!}", "\\binom{10}{7}", "\\dbinom{10}{3}"], ["720", "\\binom{10}{4}", "\\binom{3}{10}", "30"]),
    ("\\sum_{k=1}^{10} k", ["55", "\\frac{10\\cdot 11}{2}"], ["54", "10", "\\sum_{k=1}^{9} k"]),
    ("\\int_0^1 x^2 dx", ["1/3", "\\frac13"], ["1/2", "1"]),
    ("\\lfloor 7/2\\rfloor", ["3", "\\lfloor 3.5 \\rfloor"], ["4", "3.5", "\\lceil 7/2\\rceil"]),
    # Formulas with letters
    ("x^2+2x+1", ["(x+1)^2", "1+2x+x^2", "x^{2}+2x+1", "x(x+2)+1", "x*x+2*x+1", "(1+x)(x+1)"], ["x^2+1", "(x-1)^2", "x^2+2x", "y^2+2y+1", "x^2+2x+2", "(x+1)^3", "x^2+2x+1=0, 5", "4"]),
    ("\\frac{n(n+1)}{2}", ["\\frac{n^2+n}{2}", "n(n+1)/2", "\\frac{1}{2}n(n+1)", "\\binom{n+1}{2}", "0.5n^2+0.5n"], ["\\frac{n(n-1)}{2}", "n(n+1)", "\\frac{m(m+1)}{2}", "n^2", "\\frac{n(n+1)}{2}+1"]),
    ("2RC+R+C", ["R+C+2RC", "2CR + C + R", "R(1+2C)+C"], ["2rc+r+c", "RC+R+C", "2RC", "2RC-R-C"]),
    ("\\frac{x^2-1}{x-1}", ["x+1"], ["x-1", "x", "x+2"]),
    ("-(n-1)/2", ["\\frac{1-n}{2}", "\\frac{-(n-1)}{2}", "0.5-0.5n"], ["\\frac{n-1}{2}", "-n-1/2", "-\\frac{n}{2}-1"]),
    ("2^{k-n}", ["\\frac{2^k}{2^n}", "2^{-(n-k)}"], ["2^{n-k}", "2^k-n", "2^{k+n}", "\\frac{k}{n}"]),
    ("\\sin^2 x", ["1-\\cos^2 x", "(\\sin x)^2", "\\sin(x)\\sin(x)", "\\frac{1-\\cos 2x}{2}"], ["\\sin x^2", "\\cos^2 x", "\\sin 2x", "\\sin x"]),
    ("\\lceil n/2\\rceil+1", ["\\lceil \\frac{n}{2}\\rceil+1", "\\lfloor\\frac{n+1}{2}\\rfloor+1", "1+\\left\\lceil\\frac n2\\right\\rceil"], ["\\lfloor n/2\\rfloor+1", "n/2+1", "\\lceil n/2\\rceil"]),
    ("\\frac{2016}{2017^{2}}", ["2016/2017^2", "\\frac{2016}{4068289}"], ["\\frac{2016}{2017}", "(2016/2017)^2"]),
    ("a_1+a_2", ["a_2+a_1", "a_{1}+a_{2}"], ["a_1", "2a", "a_1+a_3", "a_1a_2"]),
    ("\\sqrt{x^2}", ["\\sqrt{x^2}", "|x|"], ["x", "x^2", "-x"]),
    ("f(x)=2x", ["2x", "f(x) = 2x", "f(x)=x+x", "f(t)=2t"], ["f(x)=x", "2", "g(x)=2x", "x=2", "f(x)=2x+1", "f(2x)"]),
    ("f(n)=n^2", ["n^2", "f(x)=x^2", "f(n)=n\\cdot n"], ["f(n)=2n", "n", "f(n)=n^3"]),
    ("xy", ["yx", "x\\cdot y", "xy"], ["x+y", "x", "y", "x, y"]),
    # Equations and names
    ("5", ["x=5", "n = 5", "x_1=5", "f(2)=5", "\\angle A=5", "|AB|=5", "AB = 5", "\\text{Area} = 5", "a+b=5", "2+3=5", "x=2+3=5", "m+n = 5", "k=5", "\\text{The answer is } 5", "The answer is 5", "answer: 5", "\\approx 5"],
          ["x=6", "4=5", "5=x+1", "x=5 or x=6", "x=1 or 5", "x = \\pm 5", "x \\neq 5", "x>5", "x<5", "x \\geq 5", "x^5", "x=5y", "not 5", "the answer is not 5", "anything but 5", "5 or 6", "5, 6", "5 and 6", "5;6", "one of 3, 4, 5", "3/4/5", "5...", "5?6" ]),
    ("x=5", ["5", "x=5", "5=x", "x = 5.0", "x=10/2"], ["y=5", "x=-5", "x=5 \\text{ or } x=6", "x=\\pm5", "x", "x=5+x"]),
    ("y=2x+3", ["y=3+2x", "2x+3", "2x-y+3=0", "y-3=2x", "-2x+y=3", "4x-2y+6=0"], ["y=2x-3", "y=3x+2", "2x+y+3=0", "x=2y+3", "2x+3=0", "y"]),
    ("x^2+y^2=25", ["y^2+x^2=25", "x^2+y^2-25=0", "2x^2+2y^2=50", "25=x^2+y^2"], ["x^2+y^2=5", "x^2-y^2=25", "x+y=5", "25", "x^2+y^2<25"]),
    ("x=2, y=3", ["x=2,y=3", "y=3, x=2", "x=2 \\text{ and } y=3", "(x,y)=(2,3)"], ["x=3, y=2", "y=2, x=3", "x=2", "y=3", "x=2, z=3"]),
    ("(2,3)", ["(2,3)", "(2, 3)", "\\left(2,3\\right)", "(x,y)=(2,3)", "x=2,y=3", "(4/2, 3.0)", "\\langle 2,3\\rangle", "\\begin{pmatrix}2\\\\3\\end{pmatrix}", "(x, y) = (2, 3)"],
             ["(3,2)", "[2,3]", "[2,3)", "(2,3]", "\\{2,3\\}", "(2,3,4)", "2", "3", "(2,4)", "23", "(2.3)", "x=3,y=2", "(2,3),(3,2)", "2 < x \\le 3", "3, 2"]),
    ("k \\geqslant 2", ["k\\ge 2", "k \\geq 2", "2\\le k", "[2,\\infty)", "k >= 2"], ["k>2", "k\\le 2", "(2,\\infty)", "2", "k=2", "n \\ge 2"]),
    # Several answers
    ("1, 2", ["1,2", "2, 1", "\\{1,2\\}", "1 \\text{ and } 2", "1 or 2", "x=1 \\text{ or } x=2", "x=1, 2", "x \\in \\{1,2\\}", "x_1=1, x_2=2", "1; 2", "2,1", "1,\\; 2", "$1$ and $2$", "x=2, x=1", "1, 2, 1"],
             ["1", "2", "1, 2, 3", "1, 3", "12", "[1,2]", "(2,1)", "3", "1.2", "-1,-2", "1-2", "1,2 or 3", "\\{1\\}", "\\{1,2,3\\}", "1 < x < 2"]),
    ("\\pm 2", ["2,-2", "-2, 2", "\\pm 2", "x=\\pm2", "\\{-2,2\\}", "2 \\text{ or } -2", "x = 2, x=-2", "\\pm\\sqrt{4}", "\\mp 2"], ["2", "-2", "\\pm 4", "\\pm 3", "4", "0, 2"]),
    ("\\frac{3\\pm\\sqrt{21}}{2}", ["\\frac{3+\\sqrt{21}}{2}, \\frac{3-\\sqrt{21}}{2}", "\\frac{3\\mp\\sqrt{21}}{2}", "1.5\\pm\\frac{\\sqrt{21}}{2}"], ["\\frac{3+\\sqrt{21}}{2}", "\\frac{-3\\pm\\sqrt{21}}{2}", "\\frac{3\\pm\\sqrt{21}}{4}"]),
    ("$69$,$84$", ["69, 84", "84, 69", "69 \\text{ and } 84", "\\{69,84\\}"], ["69", "84", "69,85", "6984", "69,84,90"]),
    ("1,-1,7,-7", ["\\pm1,\\pm7", "-7,-1,1,7", "\\pm 1, \\pm 7", "\\{-7,-1,1,7\\}"], ["1,7", "\\pm1", "\\pm 7", "1,-1,7", "1,-1,7,-7,0"]),
    ("\\{1,2,3\\}", ["\\{3,2,1\\}", "1,2,3", "\\left\\{1,2,3\\right\\}", "\\lbrace 1,2,3 \\rbrace", "\\{1,1,2,3\\}", "1, 2 and 3", "{1,2,3}"], ["\\{1,2\\}", "[1,3]", "\\{1,2,4\\}", "6", "\\{1,2,3,4\\}", "123"]),
    ("(1,2),(3,4)", ["(3,4),(1,2)", "(1,2) \\text{ and } (3,4)", "\\{(1,2),(3,4)\\}", "(1, 2), (3, 4)"], ["(1,2)", "(2,1),(4,3)", "(1,3),(2,4)", "1,2,3,4", "[1,2],[3,4]", "(1,2),(3,4),(5,6)"]),
    ("100,\\frac{1}{100}", ["\\frac{1}{100}, 100", "100, 0.01"], ["100", "0.01", "100.01", "100, 0.1"]),
    ("\\emptyset", ["\\varnothing", "\\{\\}", "no solution", "\\text{no solution}", "No solutions.", "∅", "none"], ["0", "\\{0\\}", "1", "\\mathbb{R}", "\\text{infinitely many}"]),
    ("f(x)=x,f(x)=-x", ["f(x)=\\pm x", "x, -x", "f(x)=-x \\text{ or } f(x)=x"], ["f(x)=x", "f(x)=-x", "f(x)=x, f(x)=2x"]),
    # Intervals, unions, inequalities
    ("[1,2]", ["[1,2]", "[1, 2]", "1\\le x\\le 2", "x\\in[1,2]", "\\left[1,2\\right]", "[1.0, 4/2]", "2 \\ge x \\ge 1"], ["(1,2)", "[1,2)", "(1,2]", "[1,3]", "\\{1,2\\}", "1,2", "1", "1<x<2", "[2,1]", "2"]),
    ("[0,1)", ["[0,1)", "0\\le x<1", "x \\in [0,1)", "[0, 1)"], ["(0,1)", "[0,1]", "[0,9)", "(0,1]", "0 < x < 1", "0, 1"]),
    ("(-\\infty,-5)", ["x<-5", "(-\\infty, -5)", "x \\in (-\\infty,-5)", "-5 > x"], ["(-\\infty,-5]", "(-\\infty,5)", "x>-5", "(-5,\\infty)", "x \\le -5", "-5"]),
    ("(-\\infty,1)\\cup(3,\\infty)", ["(3,\\infty)\\cup(-\\infty,1)", "x<1 \\text{ or } x>3", "x<1, x>3", "x \\in (-\\infty,1) \\cup (3,\\infty)"], ["(1,3)", "(-\\infty,1]\\cup[3,\\infty)", "x<1", "x>3", "(-\\infty,3)\\cup(1,\\infty)", "1, 3"]),
    ("(-\\infty, 0) \\cup\\{1\\}", ["\\{1\\}\\cup(-\\infty,0)", "(-\\infty,0)\\cup \\{1\\}"], ["(-\\infty,0)", "(-\\infty,1)", "\\{1\\}", "(-\\infty,0]\\cup\\{1\\}"]),
    ("x>3", ["3<x", "(3,\\infty)", "x > 3", "x \\gt 3", "x>\\frac{6}{2}", "x \\in (3,\\infty)"], ["x\\ge3", "x<3", "[3,\\infty)", "3", "x>4", "y>3", "x=3"]),
    ("-1<x<1", ["(-1,1)", "1>x>-1", "x\\in(-1,1)"], ["[-1,1]", "-1\\le x\\le1", "(0,1)", "x<1", "\\pm 1"]),
    ("x \\neq 2", ["x\\ne 2", "(-\\infty,2)\\cup(2,\\infty)", "\\mathbb{R}\\setminus\\{2\\}", "x != 2"], ["x=2", "2", "x>2", "\\mathbb{R}", "x\\ne 3"]),
    ("\\mathbb{R}", ["(-\\infty,\\infty)", "\\text{all real numbers}", "ℝ", "(-\\infty, +\\infty)", "\\R"], ["\\emptyset", "(0,\\infty)", "\\mathbb{Z}", "\\infty"]),
    ("[-1,-\\frac{1}{2}]", ["[-1,-0.5]", "-1\\le x\\le -\\frac12"], ["[-1,\\frac12]", "(-1,-\\frac12)", "[-\\frac12,-1]"]),
    # Tuples and vectors
    ("(1,2,3)", ["(1,2,3)", "\\langle 1,2,3\\rangle", "(1, 2, 3)", "\\begin{pmatrix} 1 \\\\ 2 \\\\ 3 \\end{pmatrix}", "(a,b,c)=(1,2,3)"], ["(3,2,1)", "(1,2)", "\\{1,2,3\\}", "(1,2,3,4)", "6", "(1,2,4)", "(1;3;2)"]),
    ("(45^{\\circ}, 60^{\\circ})", ["(45,60)", "(45°, 60°)"], ["(60,45)", "(45,61)", "45"]),
    ("(3, \\frac{\\pi}{2})", ["\\left(3,\\frac{\\pi}{2}\\right)", "(3,\\pi/2)", "(3, 0.5\\pi)"], ["(3,\\pi)", "(\\frac{\\pi}{2},3)", "(3,1.57)"]),
    # Matrices
    ("\\begin{pmatrix}1&2\\\\3&4\\end{pmatrix}", ["\\begin{bmatrix}1&2\\\\3&4\\end{bmatrix}", "\\begin{pmatrix} 1 & 2 \\\\ 3 & 4 \\end{pmatrix}", "\\left[\\begin{array}{cc}1&2\\\\3&4\\end{array}\\right]", "\\begin{pmatrix}1&\\frac42\\\\3&2^2\\end{pmatrix}", "[[1,2],[3,4]]", "\\begin{pmatrix}1&2\\\\3&4\\\\\\end{pmatrix}"],
     ["\\begin{pmatrix}1&3\\\\2&4\\end{pmatrix}", "\\begin{pmatrix}1&2\\\\3&5\\end{pmatrix}", "\\begin{pmatrix}1&2&3&4\\end{pmatrix}", "-2", "1,2,3,4", "\\begin{vmatrix}1&2\\\\3&4\\end{vmatrix}", "\\begin{pmatrix}1&2\\end{pmatrix}"]),
    ("\\begin{pmatrix}-1/2\\\\\\sqrt{3}\\end{pmatrix}", ["\\begin{pmatrix}-\\frac12\\\\\\sqrt3\\end{pmatrix}", "\\begin{bmatrix}-0.5\\\\ \\sqrt{3}\\end{bmatrix}"], ["\\begin{pmatrix}\\sqrt3\\\\-\\frac12\\end{pmatrix}", "\\begin{pmatrix}1/2\\\\\\sqrt{3}\\end{pmatrix}"]),
    # Ratios, bases, clock times
    ("3:4", ["3:4", "3 : 4", "\\frac{3}{4}", "6:8", "3/4"], ["4:3", "3:5", "34", "7"]),
    ("1:2:3", ["1:2:3", "2:4:6"], ["3:2:1", "1:2", "1:2:4"]),
    ("3:30", ["3:30"], ["3:31", "6:60", "1:10", "4:30"]),
    ("1011_2", ["1011_2", "1011_{2}", "1011", "1011_{\\text{two}}"], ["1011_3", "1101_2", "11", "1010_2"]),
    ("101", ["101", "101_{10}"], ["101_2", "5", "110"]),
    # Words, letters, yes and no
    ("\\text{Yes}", ["yes", "Yes", "YES.", "\\text{yes}", "\\textbf{Yes}", "$\\text{Yes}$"], ["no", "\\text{No}", "true", "yes or no", "yes, no", "not yes", "y", "maybe", "1"]),
    ("no", ["No", "\\text{no}", "NO"], ["yes", "none of these", "not"]),
    ("True", ["true", "\\text{True}", "\\mathrm{true}"], ["false", "T", "true or false", "1"]),
    ("\\text{Monday}", ["Monday", "monday", "\\mathrm{Monday}"], ["Tuesday", "Mon", "Monday and Tuesday", "not Monday"]),
    ("\\text{red}, \\text{blue}", ["blue, red", "red and blue", "\\text{blue and red}"], ["red", "blue", "red, green"]),
    ("B", ["B", "(B)", "\\text{B}", "\\textbf{(B)}", "b", "B.", "(b)", "option B", "\\text{(B)}", "B)", "\\mathrm{B}", "(B) 12", "\\textbf{(B)}\\ 12", "B: 12"], ["A", "(C)", "AB", "A or B", "not B", "8", "A, B", "(A) B", "B or C", "ABCD"]),
    ("\\textbf{(C)}\\ 30", ["C", "(C)", "30", "\\textbf{(C)}\\ 30", "(C) 30"], ["A", "(D) 30" , "31", "(A)"]),
    ("12", ["(B) 12", "\\textbf{(B) }12", "12"], ["(B)", "B", "(B) 13", "12 (B) 13"]),
    ("\\text{odd}", ["odd", "Odd"], ["even", "odd and even"]),
    ("\\infty", ["\\infty", "infinity", "∞", "+\\infty", "inf"], ["-\\infty", "0", "10^{100}", "\\text{undefined}", "x"]),
    ("-\\infty", ["-\\infty", "-∞"], ["\\infty", "0", "-1"]),
    ("\\text{undefined}", ["undefined", "Undefined"], ["0", "\\infty", "defined"]),
    ("A, C", ["A, C", "C, A", "A and C", "\\text{A, C}"], ["A", "C", "A, B, C", "A, B"]),
]
# fmt: on
PAIRS = [(gold, answer, True) for gold, rights, _ in CASES for answer in rights]
PAIRS += [(gold, answer, False) for gold, _, wrongs in CASES for answer in wrongs]


@pytest.mark.parametrize(("gold", "answer", "right"), PAIRS)
def test_verdict(gold: str, answer: str, right: bool):
    """A boxed answer gets the verdict that it deserves."""
    verdict = grade(f"Some reasoning with $x=3$.\n\\boxed{{{answer}}}", gold, timeout_s=10.0)
    assert verdict.correct is right, verdict
    assert verdict.reward == float(right)
