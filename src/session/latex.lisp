;;; anmech: equations in LaTeX, as in a book: dots for derivatives by time, parameters before variables and these before
;;; functions, fractions in front of sums, and long sums broken at their terms.
;;;
;;; Entry points: $anmech_latex_equations; LATEX-DISPLAY.
;;;
;;; A formula is made of PIECES, between which a line may end: the terms of a sum, and where a term is itself too long,
;;; the terms of the sum that is its factor.

(in-package :anmech)
(needs "session/letters" "session/scope" "session/texts")

(defvar *time* 'maxima::$t "The derivatives by it are dots.")
(defvar *moving* '() "The variables: they follow the parameters.")

;;; Names

(defparameter *latex-functions*
  '((maxima::%sin "\\sin") (maxima::%cos "\\cos") (maxima::%tan "\\tan") (maxima::%cot "\\cot") (maxima::%sec "\\sec")
    (maxima::%csc "\\csc") (maxima::%sinh "\\sinh") (maxima::%cosh "\\cosh") (maxima::%tanh "\\tanh")
    (maxima::%coth "\\coth") (maxima::%asin "\\arcsin") (maxima::%acos "\\arccos") (maxima::%atan "\\arctan")
    (maxima::%log "\\ln") (maxima::%signum "\\operatorname{sgn}")))

(defun latex-letter (name)
  "NAME as one letter or as a word in italics."
  (multiple-value-bind (place capital) (greek-place name)
    (cond ((and place capital)
           (let ((letter (string-capitalize (nth place *greek*))))
             (if (member letter '("Gamma" "Delta" "Theta" "Lambda" "Xi" "Pi" "Sigma" "Upsilon" "Phi" "Psi" "Omega")
                         :test #'string=)
                 (format nil "\\~a" letter)
                 (format nil "\\mathrm{~a}" (char letter 0)))))
          (place (let ((letter (nth place *greek*)))
                   (cond ((string= letter "omicron") "o")
                         ((member letter '("epsilon" "theta" "phi") :test #'string=) (format nil "\\var~a" letter))
                         (t (format nil "\\~a" letter)))))
          ((= (length name) 1) (as-word name))
          (t (format nil "\\mathit{~a}" (as-word name))))))

(defun as-word (name)
  "NAME with LaTeX's own signs marked."
  (with-output-to-string (out)
    (loop for char across name
          do (case char
               ((#\_ #\% #\& #\# #\$ #\{ #\}) (format out "\\~a" char))
               (#\\ (write-string "\\backslash " out))
               (#\~ (write-string "\\sim " out))
               (#\^ (write-string "\\hat{}" out))
               (t (write-char char out))))))

(defun latex-index (index)
  (cond ((or (every #'digit-char-p index) (= (length index) 1)) (as-word index))
        ((greek-place index) (latex-letter index))
        ((find #\_ index) (latex-stem-and-index index))
        (t (format nil "\\mathrm{~a}" (as-word index)))))

(defun latex-stem-and-index (name)
  (multiple-value-bind (stem index) (stem-and-index name)
    (format nil "~a~@[_{~a}~]" (latex-letter stem) (and index (latex-index index)))))

(defparameter *accents* '("\\dot" "\\ddot" "\\dddot" "\\ddddot"))

(defun latex-name (variable &optional (dots 0))
  "VARIABLE, a symbol or one with subscripts, its letter under DOTS."
  (multiple-value-bind (stem index) (stem-and-index (plain-name (if (atom variable) variable (caar variable))))
    (let ((letter (latex-letter stem))
          (indices (append (and index (list (latex-index index)))
                           (and (consp variable) (mapcar #'latex (rest variable))))))
      (format nil "~a~@[_{~{~a~^,~}}~]"
              (if (plusp dots) (format nil "~a{~a}" (nth (1- dots) *accents*) letter) letter)
              indices))))

(defun latex-symbol (symbol)
  (case symbol
    (maxima::$%pi "\\pi") (maxima::$%e "e") (maxima::$%i "\\mathrm{i}") (maxima::$inf "\\infty")
    (maxima::$minf "-\\infty") ((t maxima::$true) "\\mathrm{true}") ((nil maxima::$false) "\\mathrm{false}")
    (t (latex-name symbol))))

(defun variable-p (form)
  (or (symbolp form) (and (consp form) (member 'maxima::array (first form)) t)))

;;; Numbers and signs

(defun latex-number (number)
  (let* ((text (string-trim " " (plain-name number)))
         (exponent (position-if (lambda (char) (find char "eEbBdD")) text)))
    (if exponent
        (let ((power (parse-integer text :start (1+ exponent))))
          (if (zerop power) (subseq text 0 exponent) (format nil "~a\\cdot 10^{~d}" (subseq text 0 exponent) power)))
        text)))

(defun number-form-p (form)
  (or (numberp form) (operator-p form 'maxima::rat) (operator-p form 'maxima::bigfloat)))

(defun negative-number-p (form)
  (cond ((realp form) (minusp form))
        ((number-form-p form) (minusp (second form)))))

(defun without-sign (term)
  "TERM and nil, or what is left of it without a minus sign, and true."
  (cond ((negative-number-p term) (values (maxima::mul -1 term) t))
        ((and (operator-p term 'maxima::mtimes) (some #'negative-number-p (rest term)))
         (let* ((number (find-if #'negative-number-p (rest term)))
                (positive (maxima::mul -1 number))
                (others (remove number (rest term) :count 1 :test #'eq)))
           (values (cond ((not (eql positive 1)) (list* (first term) positive others))
                         ((rest others) (cons (first term) others))
                         (t (first others)))
                   t)))
        (t (values term nil))))

;;; Expressions

(defun latex (form)
  "FORM in one line."
  (cond ((operator-p form 'maxima::mplus) (text-of-pieces (sum-pieces form)))
        (t (multiple-value-bind (positive negative) (without-sign form)
             (format nil "~:[~;-~]~a" negative (latex-term positive))))))

(defun text-of-pieces (pieces)
  (format nil "~{~a~}" pieces))

(defun sum-pieces (form &optional (width nil))
  "The terms of FORM with their signs; those that are wider than WIDTH are broken."
  (loop for term in (if (operator-p form 'maxima::mplus) (plus-first (reverse (rest form))) (list form))
        for first = t then nil
        append (multiple-value-bind (positive negative) (without-sign term)
                 (destructuring-bind (piece . others) (term-pieces positive width)
                   (cons (format nil "~a~a" (cond (negative "-") (first "") (t "+")) piece) others)))))

(defun plus-first (terms)
  "TERMS, with one to begin with that has no minus sign, if there is any."
  (let ((first (find-if-not (lambda (term) (nth-value 1 (without-sign term))) terms)))
    (if first (cons first (remove first terms :count 1 :test #'eq)) terms)))

(defun term-pieces (term width)
  "TERM in one piece, or where it is too wide, and has a sum as a factor, in those of the sum."
  (let ((whole (latex-term term)))
    (multiple-value-bind (before sum after)
        (if (and width (> (formula-width whole) width)) (around-the-sum term) nil)
      (if (null sum)
          (list whole)
          (let* ((pieces (sum-pieces sum width))
                 (end (last pieces)))
            (setf (first pieces) (format nil "~@[~a\\,~]\\bigl(~a" (and (string/= before "") before) (first pieces))
                  (first end) (format nil "~a\\bigr)~@[\\,~a~]" (first end) (and (string/= after "") after)))
            pieces)))))

(defun latex-term (term)
  (cond ((symbolp term) (latex-symbol term))
        ((stringp term) (format nil "\\text{~a}" term))
        ((operator-p term 'maxima::rat) (format nil "\\frac{~d}{~d}" (second term) (third term)))
        ((number-form-p term) (latex-number term))
        ((atom term) (latex-by-maxima term))
        ((member (caar term) '(maxima::mtimes maxima::mexpt)) (latex-product term))
        ((operator-p term 'maxima::mplus) (in-parentheses (latex term)))
        (t (latex-operation term))))

;;; Products: what stands where

(defun product-factors (term)
  (if (operator-p term 'maxima::mtimes) (rest term) (list term)))

(defun inverse-of (factor)
  "What FACTOR is one divided by, or nil."
  (and (operator-p factor 'maxima::mexpt)
       (not (eq (second factor) 'maxima::$%e))
       (let ((exponent (third factor)))
         (and (negative-number-p exponent)
              (maxima::power (second factor) (maxima::mul -1 exponent))))))

(defun over-and-under (term)
  "The factors of the numerator and of the denominator of TERM."
  (let ((over '()) (under '()))
    (dolist (factor (product-factors term) (values (ranked over) (ranked under)))
      (cond ((operator-p factor 'maxima::rat)
             (unless (eql (second factor) 1) (push (second factor) over))
             (push (third factor) under))
            ((inverse-of factor) (push (inverse-of factor) under))
            (t (push factor over))))))

(defun ranked (factors)
  (stable-sort (reverse factors) #'< :key #'factor-rank))

(defun factor-rank (factor)
  (let ((base (if (and (operator-p factor 'maxima::mexpt) (not (eq (second factor) 'maxima::$%e)))
                  (second factor)
                  factor)))
    (cond ((number-form-p base) 0)
          ((variable-p base) (if (member base *moving* :test #'equal) 3 1))
          ((operator-p base 'maxima::%derivative) 4)
          ((operator-p base 'maxima::mplus) (if (moving-p base) 5 2))
          ((and (operator-p factor 'maxima::mexpt) (not (integerp (third factor)))) 5)
          (t 6))))

(defun moving-p (form)
  (or (and (variable-p form) (or (eq form *time*) (member form *moving* :test #'equal)) t)
      (and (consp form) (some #'moving-p (rest form)))))

(defun latex-factors (factors)
  (format nil "~{~a~^\\,~}" (mapcar #'latex-power factors)))

(defun latex-product (term)
  (multiple-value-bind (over under) (over-and-under term)
    (cond ((null under) (latex-factors over))
          (t (let* ((sum (and (rest over) (find-if #'long-sum-p over)))
                    (trailing (and sum (member sum over :test #'eq)))
                    (leading (ldiff over trailing)))
               (format nil "~a~@[\\,~a~]"
                       (latex-fraction leading under) (and trailing (latex-factors trailing))))))))

(defun latex-fraction (over under)
  (format nil "\\frac{~a}{~a}"
          (cond ((null over) "1")
                ((rest over) (latex-factors over))
                (t (latex (first over))))
          (if (rest under) (latex-factors under) (latex (first under)))))

(defun long-sum-p (factor)
  (and (operator-p factor 'maxima::mplus) (= (factor-rank factor) 5)))

(defun around-the-sum (term)
  "What stands before the longest sum that is a factor of TERM, the sum, and what stands after it."
  (multiple-value-bind (over under) (over-and-under term)
    (let* ((sums (remove-if-not (lambda (factor) (operator-p factor 'maxima::mplus)) over))
           (sum (first (sort (copy-list sums) #'> :key #'length)))
           (place (position sum over :test #'eq)))
      (when sum
        (let ((before (subseq over 0 place)))
          (values (if under (latex-fraction before under) (latex-factors before))
                  sum
                  (latex-factors (nthcdr (1+ place) over))))))))

(defun latex-power (factor)
  "A factor, a power perhaps, as it stands in a product."
  (if (and (operator-p factor 'maxima::mexpt) (not (inverse-of factor)))
      (destructuring-bind (base exponent) (rest factor)
        (cond ((equal exponent '((maxima::rat maxima::simp) 1 2)) (format nil "\\sqrt{~a}" (latex base)))
              ((and (consp base) (assoc (caar base) *latex-functions*) (integerp exponent))
               (latex-function base (latex-exponent exponent)))
              (t (format nil "~a^{~a}" (latex-base base) (latex-exponent exponent)))))
      (cond ((operator-p factor 'maxima::mtimes) (latex-product factor))
            ((member (caar-or-nil factor) '(maxima::mcond maxima::%mcond)) (in-parentheses (latex-term factor)))
            (t (latex-term factor)))))

(defun caar-or-nil (form)
  (and (consp form) (caar form)))

(defun latex-exponent (exponent)
  (if (operator-p exponent 'maxima::rat)
      (format nil "~d/~d" (second exponent) (third exponent))
      (latex exponent)))

(defun latex-base (base)
  (cond ((or (variable-p base) (and (integerp base) (>= base 0))) (latex-term base))
        ((and (operator-p base 'maxima::%derivative) (dotted-p base)) (latex-term base))
        (t (in-parentheses (latex base)))))

(defun in-parentheses (text)
  (if (high-p text) (format nil "\\left(~a\\right)" text) (format nil "(~a)" text)))

(defun in-brackets (text)
  (if (high-p text) (format nil "\\left[~a\\right]" text) (format nil "[~a]" text)))

(defun high-p (text)
  (or (search "\\frac" text) (search "\\begin" text)))

;;; Functions and derivatives

(defun latex-function (form &optional power)
  "sin x, or sin^2 x; parentheses around what is no single name."
  (let* ((name (second (assoc (caar form) *latex-functions*)))
         (argument (latex (second form)))
         (head (format nil "~a~@[^{~a}~]" name power)))
    (if (or (variable-p (second form)) (integerp (second form)))
        (format nil "~a ~a" head argument)
        (format nil "~a~a" head (in-parentheses argument)))))

(defun latex-arguments (form)
  (in-parentheses (format nil "~{~a~^,~}" (mapcar #'latex (rest form)))))

(defun open-function-p (form)
  "F(t), a function that is not known."
  (and (consp form) (symbolp (caar form)) (rest form) (not (variable-p form))
       (char= (char (symbol-name (caar form)) 0) #\$)))

(defun latex-operation (form)
  (cond ((variable-p form) (latex-name form))
        ((assoc (caar form) *latex-functions*) (latex-function form))
        ((operator-p form 'maxima::mabs) (format nil "\\left|~a\\right|" (latex (second form))))
        ((operator-p form 'maxima::mequal) (format nil "~a = ~a" (latex (second form)) (latex (third form))))
        ((operator-p form 'maxima::%derivative) (latex-derivative form))
        ((member (caar form) '(maxima::$max maxima::$min))
         (format nil "\\~a~a" (plain-name (caar form)) (latex-arguments form)))
        ((member (caar form) '(maxima::$atan2 maxima::%atan2))
         (format nil "\\operatorname{atan2}~a" (latex-arguments form)))
        ((operator-p form 'maxima::mlist) (in-brackets (format nil "~{~a~^,\\;~}" (mapcar #'latex (rest form)))))
        ((operator-p form 'maxima::$matrix) (latex-matrix form))
        ((and (member (caar form) '(maxima::$lsum maxima::%lsum)) (operator-p (fourth form) 'maxima::$rootsof))
         (latex-sum-over-roots form))
        ((open-function-p form) (format nil "~a~a" (latex-name (caar form)) (latex-arguments form)))
        (t (latex-by-maxima form))))

(defun latex-sum-over-roots (form)
  "The roots have a letter that does not occur otherwise."
  (destructuring-bind (summand root (head polynomial . rest)) (rest form)
    (declare (ignore head rest))
    (let ((letter (find-if (lambda (letter) (maxima::$freeof letter form)) '(maxima::$r maxima::$s maxima::$z))))
      (flet ((shown (part) (latex (if letter (subst letter root part) part))))
        (format nil "\\sum_{~a\\,:\\;~a = 0} ~a" (shown (or letter root)) (shown polynomial)
                (if (operator-p summand 'maxima::mplus) (in-parentheses (shown summand)) (shown summand)))))))

(defun latex-matrix (form)
  (format nil "\\begin{pmatrix}~{~{~a~^ & ~}~^ \\\\ ~}\\end{pmatrix}"
          (loop for row in (rest form) collect (mapcar #'latex (rest row)))))

(defun dotted-p (form)
  "Whether FORM is the derivative by time, alone, of a variable or of a function of time."
  (destructuring-bind (what by order . others) (rest form)
    (and (null others) (eq by *time*) (typep order '(integer 1 4))
         (or (variable-p what) (and (open-function-p what) (equal (rest what) (list *time*)))))))

(defun latex-derivative (form)
  (destructuring-bind (what by order . others) (rest form)
    (cond ((and (dotted-p form) (variable-p what)) (latex-name what order))
          ((dotted-p form) (format nil "~a~a" (latex-name (caar what) order) (latex-arguments what)))
          ((and (open-function-p what) (equal (rest what) (list by)) (member order '(1 2 3)))
           (format nil "~a~a~a" (latex-name (caar what)) (make-string order :initial-element #\')
                   (latex-arguments what)))
          (t (latex-quotient what (list* by order others))))))

(defun latex-quotient (what by)
  "d^2 F/dx dy, partial where there are several variables."
  (let* ((sign (if (or (cddr by) (and (open-function-p what) (cddr what))) "\\partial" "\\mathrm{d}"))
         (total (loop for (nil order) on by by #'cddr sum order)))
    (flet ((power (order) (and (/= order 1) (format nil "^{~d}" order))))
      (format nil "\\frac{~a~@[~a~] ~a}{~{~a~^\\,~}}" sign (power total)
              (if (operator-p what 'maxima::mplus) (in-parentheses (latex what)) (latex what))
              (loop for (variable order) on by by #'cddr
                    collect (format nil "~a ~a~@[~a~]" sign (latex variable) (power order)))))))

(defun latex-by-maxima (form)
  "Integrals, conditionals and the like, in which names are as above."
  (labels ((walk (form)
             (cond ((and (consp form) (operator-p form 'maxima::%derivative) (dotted-p form)) (named (latex form)))
                   ((and form (symbolp form) (char= (char (symbol-name form) 0) #\$)) (named (latex-symbol form)))
                   ((atom form) form)
                   ((variable-p form) (named (latex-name form)))
                   (t (cons (first form) (mapcar #'walk (rest form))))))
           (named (text)
             (let ((symbol (make-symbol "NAMED")))
               (setf (get symbol 'maxima::texword) text)
               symbol)))
    (string-trim '(#\Space #\Newline) (coerce (maxima::mfuncall 'maxima::$tex1 (walk form)) 'string))))

;;; How wide a formula is, in letters

(defun group-end (text start)
  "The place behind the group in braces that begins at START, or behind one sign."
  (if (and (< start (length text)) (char= (char text start) #\{))
      (let ((depth 0))
        (loop for place from start below (length text)
              do (case (char text place)
                   (#\{ (incf depth))
                   (#\} (when (zerop (decf depth)) (return (1+ place)))))
              finally (return (length text))))
      (min (length text) (1+ start))))

(defun formula-width (text &optional (start 0) (end (length text)))
  (let ((width 0) (place start))
    (loop while (< place end)
          do (let ((char (char text place)))
               (cond ((and (char= char #\\) (< (1+ place) end) (alpha-char-p (char text (1+ place))))
                      (let* ((name-end (or (position-if-not #'alpha-char-p text :start (1+ place)) end))
                             (name (subseq text (1+ place) name-end)))
                        (setf place name-end)
                        (cond ((string= name "frac")
                               (let* ((middle (group-end text place)) (last (group-end text middle)))
                                 (incf width (max (formula-width text place middle) (formula-width text middle last)))
                                 (setf place last)))
                              ((member name '("sin" "cos" "tan" "cot" "sec" "csc" "ln" "sinh" "cosh" "tanh" "arcsin"
                                              "arccos" "arctan")
                                       :test #'string=)
                               (incf width (+ 0.5 (* 0.9 (length name)))))
                              ((member name '("dot" "ddot" "dddot" "ddddot" "mathit" "mathrm" "operatorname" "left"
                                              "right" "bigl" "bigr" "text")
                                       :test #'string=))
                              (t (incf width)))))
                     ((find char "_^")
                      (let ((last (group-end text (1+ place))))
                        (incf width (* 0.7 (formula-width text (1+ place) last)))
                        (setf place last)))
                     (t (incf width (case char
                                      ((#\{ #\} #\\ #\Space) 0)
                                      (#\, 0.3)
                                      ((#\+ #\- #\=) 2.2)
                                      ((#\( #\) #\' #\.) 0.7)
                                      (t 1)))
                        (incf place)))))
    width))

;;; Lines

(defparameter *line-width* 60 "Letters in a line of a page.")

(defun lines-of (pieces width)
  "PIECES in lines as full as may be, each a text."
  (let ((lines '()) (line '()) (used 0))
    (dolist (piece pieces)
      (let ((more (formula-width piece)))
        (when (and line (> (+ used more) width))
          (push (text-of-pieces (reverse line)) lines)
          (setf line '() used 0))
        (push piece line)
        (incf used more)))
    (reverse (cons (text-of-pieces (reverse line)) lines))))

(defun equation-lines (left right aligned)
  "The lines of an equation: where ALIGNED, its sides stand apart, and the right one is broken; else both are."
  (let* ((width (if aligned (- *line-width* (formula-width left)) *line-width*))
         (room (- width 4)))
    (if aligned
        (destructuring-bind (first . others) (lines-of (sum-pieces right room) width)
          (cons (format nil "~a &= ~a" left first)
                (mapcar (lambda (line) (format nil "&\\quad ~a" (with-free-sign line))) others)))
        (lines-below (lines-of (append (sum-pieces left room) (right-pieces right room)) width)))))

(defun lines-below (lines)
  "The first of LINES, and the others a little to the right."
  (cons (format nil "&~a" (first lines))
        (mapcar (lambda (line) (format nil "&\\quad ~a" (with-free-sign line))) (rest lines))))

(defun right-pieces (right room)
  (let ((pieces (sum-pieces right room)))
    (cons (format nil "= ~a" (first pieces)) (rest pieces))))

(defun with-free-sign (line)
  "The sign that LINE begins with as one between two terms."
  (if (find (char line 0) "+-") (format nil "{}~a" line) line))

(defun lines-of-each (forms)
  "For each of FORMS, equations or what else there is, the list of its lines.  Signs of equality stand below each other
where what is left of them is short; else the equations begin below each other."
  (let ((aligned (every (lambda (form)
                          (and (operator-p form 'maxima::mequal)
                               (< (formula-width (latex (second form))) (* 0.45 *line-width*))))
                        forms)))
    (loop for form in forms
          collect (cond (aligned (equation-lines (latex (second form)) (third form) t))
                        ((operator-p form 'maxima::mequal) (equation-lines (second form) (third form) nil))
                        (t (lines-below (lines-of (sum-pieces form (- *line-width* 4)) *line-width*)))))))

(defun latex-align (lines)
  (coerce (format nil "\\begin{align*}~%~{  ~a~^ \\\\~%~}~%\\end{align*}~%" lines) 'simple-string))

(defun latex-display (form moving time)
  "FORM, of which MOVING are the variables, as one display; a list that is too long for a line, a line for each of its
members at least."
  (let ((*time* time) (*moving* moving))
    (latex-align
     (if (and (operator-p form 'maxima::mlist) (rest form) (> (formula-width (latex form)) *line-width*))
         (lines-in-brackets (lines-of-each (rest form)))
         (first (lines-of-each (list form)))))))

(defun lines-in-brackets (members)
  "The lines of MEMBERS, with the signs of a list around and between them."
  (loop for (lines . others) on members
        for before = "[" then nil
        append (loop for (line . more) on lines
                     for here = before then nil
                     collect (format nil "~@[~a~]~a~@[~a~]" here line (cond (more nil) (others ",") (t "]"))))))

(maxima::defmfun maxima::$anmech_latex_equations (equations moving time)
  "anmech_latex_equations([equation, ...], [variable, ...], time): as one aligned display of LaTeX, a string."
  (let ((*time* time) (*moving* (rest moving)))
    (latex-align (apply #'append (lines-of-each (rest equations))))))
