;;; anmech: jets, the private symbols that stand for coordinates and their derivatives.
;;;
;;; Inside the package x, diff(x,t), diff(x,t,2) ... are the symbols x'0, x'1, x'2, so that partial derivatives are
;;; Maxima's plain diff, whatever dependencies the session has declared.  A jet carries what it stands for, so the way
;;; back needs no table.
;;;
;;; Entry points: anmech_jet, anmech_to_jets, anmech_from_jets, anmech_jets_in, anmech_total, anmech_partial,
;;; anmech_partials, anmech_replaced, anmech_along_one_jet, anmech_jet_order, anmech_jet_parts; assume-for-jets.

(in-package :anmech)
(needs "session/guard" "session/patience" "session/scope" "session/texts" "algebra/kinks" "algebra/terms")

(defvar *times* '(maxima::$t) "What derivatives have been taken by.")

(defun jet (variable order time)
  "The symbol for the derivative of ORDER of VARIABLE with respect to TIME."
  (let ((symbol (intern (format nil "~a'~d~:[(~a)~;~]" (jet-stem variable) order (eq time 'maxima::$t) time) :maxima)))
    (unless (get symbol 'jet)
      (pushnew time *times*)
      (setf (get symbol 'jet) (list variable order time)))
    symbol))

(defun jet-stem (variable)
  (if (symbolp variable) (symbol-name variable) (concatenate 'string "$" (plain-name variable))))

(defun jet-of (form)
  "(variable order time) if FORM is a jet."
  (and form (symbolp form) (get form 'jet)))

(defun to-jets (form variables time)
  "FORM with each of VARIABLES and its derivatives by TIME replaced; VARIABLES is a hash table of plain keys."
  (labels ((known (form) (gethash (plain-key form) variables))
           (walk (form)
             (cond ((and (symbolp form) form) (if (known form) (jet form 0 time) form))
                   ((atom form) form)
                   ((eq (caar form) 'maxima::mrat) (walk (maxima::$ratdisrep form)))
                   ((and (member 'maxima::array (first form)) (known form)) (jet form 0 time))
                   ((eq (caar form) 'maxima::%derivative) (derivative form))
                   ((member (caar form) '(maxima::mcond maxima::$unit_step)) (chosen form))
                   (t (with-arguments form (mapcar #'walk (rest form))))))
           (chosen (form)                                ; Maxima evaluates nothing in a conditional
             (by-signs (with-arguments form (mapcar #'walk (rest (with-derivatives form))))))
           (derivative (form)
             (let ((inner (walk (second form))))
               (multiple-value-bind (order others) (steps-by time form)
                 (cond ((and (jet-of inner) (integerp order) (null others)) (jet (second form) order time))
                       ((known (second form))
                        (complain "~a is a derivative of a coordinate by something other than ~a"
                                  (one-line form) (plain-name time)))
                       ((integerp order)                     ; diff(f(x), t), which Maxima leaves as it is
                        (let ((slope (derived inner (mapcar #'walk others))))
                          (loop repeat order do (setq slope (derivative-along slope (rate-for-maxima time))))
                          slope))
                       (t (with-arguments form (cons inner (mapcar #'walk (cddr form))))))))))
    (walk form)))

(defun with-derivatives (form)
  "FORM with the calls of diff in it as derivatives."
  (cond ((atom form) form)
        ((eq (caar form) 'maxima::$diff)
         (maxima::simplifya `((maxima::%derivative) ,@(mapcar #'with-derivatives (rest form))
                              ,@(if (= (length form) 3) '(1)))
                            t))
        (t (with-arguments form (mapcar #'with-derivatives (rest form))))))

(defun steps-by (time form)
  "The order of the derivative FORM by TIME, and its other steps: variable, order, ..."
  (let ((order 0) (others '()))
    (loop for (variable times) on (cddr form) by #'cddr
          do (if (eq variable time)
                 (setq order (maxima::add order times))
                 (setq others (list* times variable others))))
    (values order (nreverse others))))

(defun derived (form steps)
  (if steps (maxima::simplifya `((maxima::%derivative) ,form ,@steps) t) form))

(defun rate-for-maxima (time)
  "What Maxima takes for the derivative of a symbol by TIME: that of a coordinate is zero unless it was declared."
  (lambda (symbol)
    (let ((jet (jet-of symbol)))
      (cond ((null jet) (maxima::sdiff symbol time))
            ((and (zerop (second jet)) (eql 0 (maxima::sdiff (first jet) time))) 0)
            ((eq (third jet) time) (jet (first jet) (1+ (second jet)) time))
            (t 0)))))

(defun from-jets (form)
  (let ((jet (jet-of form)))
    (cond (jet (destructuring-bind (variable order time) jet
                 (if (zerop order)
                     variable
                     `((maxima::%derivative maxima::simp) ,variable ,time ,order))))
          ((atom form) form)
          ((eq (caar form) 'maxima::mrat) (from-jets (maxima::$ratdisrep form)))
          ((eq (caar form) 'maxima::%derivative) (derivative-from-jets form))
          (t (with-arguments form (mapcar #'from-jets (rest form)))))))

(defun derivative-from-jets (form)
  "The partial derivative FORM of an undefined function.  In Maxima's terms diff(f(x,t), t) is its total derivative
where x was declared, so what x contributes to that is taken away."
  (let* ((jet (first (jets-in (second form)))) (time (and jet (third (jet-of jet)))))
    (multiple-value-bind (order others) (steps-by time form)
      (if (and jet (integerp order) (plusp order))
          (let* ((slope (derived (second form) others)) (total slope))
            (loop repeat order do (setq total (derivative-along total (rate-for-maxima time))))
            (maxima::sub (derived (from-jets slope) (list time order)) (from-jets (maxima::sub total form))))
          (with-arguments form (mapcar #'from-jets (rest form)))))))

;;; What the user has assumed of a variable holds of its jet too.

(defun assume-for-jets (facts)
  "Say FACTS, relations of variables and derivatives, again of the jets that stand for them, in the present context.
Maxima has some of its own, of %e and the like, which hold already: to say them takes long."
  (dolist (fact (relations-of-variables facts))
    (dolist (time *times*)
      (unless (some-part (lambda (form) (and (eq (caar form) 'maxima::%derivative) (not (eq (third form) time))))
                         fact)
        (maxima::meval (list '(maxima::$assume) (to-jets fact (variables-in fact time) time)))))))

(defvar *last-facts* '(nil) "Facts, and those among them that are relations of variables.")

(defun relations-of-variables (facts)
  "The guard hands on the very same list as long as nothing else is assumed."
  (unless (eq facts (first *last-facts*))
    (setq *last-facts*
          (cons facts
                (remove-if-not
                 (lambda (fact)
                   (and (consp fact)
                        (member (caar fact) '(maxima::mgreaterp maxima::mgeqp maxima::$equal maxima::$notequal
                                              maxima::mnot))
                        (notevery #'maxima::$constantp (rest fact))))
                 facts))))
  (rest *last-facts*))

(defun variables-in (form time)
  "A hash table of the plain keys of the variables in FORM, without TIME."
  (let ((table (make-hash-table :test #'equal)))
    (labels ((walk (form)
               (cond ((and form (symbolp form)) (unless (eq form time) (setf (gethash form table) t)))
                     ((consp form)
                      (when (member 'maxima::array (first form)) (setf (gethash (plain-key form) table) t))
                      (mapc #'walk (rest form))))))
      (walk form))
    table))

(defun jets-in (form)
  "The jets that occur in FORM, in the order of their names."
  (let ((found '()))
    (labels ((walk (form)
               (cond ((jet-of form) (pushnew form found))
                     ((consp form) (mapc #'walk (rest form))))))
      (walk form))
    (sort found #'string< :key #'symbol-name)))

;;; Derivatives.  One pass through an expression gives its derivative in a direction: RATE tells what the derivative of
;;; each symbol is.  Maxima's own diff takes one pass for each variable.

(defun derivative-along (form rate)
  "The derivative of FORM, the derivative of a symbol being (funcall RATE symbol).  An operator that binds a symbol has
a rule of its own, the property derivative-rule."
  (cond ((symbolp form) (if form (funcall rate form) 0))
        ((atom form) 0)
        (t (case (caar form)
             (maxima::mplus
              (sum-of (remove 0 (mapcar (lambda (term) (derivative-along term rate)) (rest form)) :test #'eql)))
             (maxima::mtimes (derivative-of-product form rate))
             (maxima::mexpt (derivative-of-power form rate))
             (maxima::%signum 0)                           ; off the kink, as for all of these
             (t (funcall (get (caar form) 'derivative-rule 'derivative-of-function) form rate))))))

(defvar *slope-of-abs* nil
  "Whether the derivative of abs(u) is signum(u) u', not u u'/abs(u), which has no value at 0.")

(defun derivative-by-signs (form rate)
  (let ((signs (by-signs form)) (*slope-of-abs* t))
    (if (eq signs form)
        (complain "~a has no derivative: its condition is no comparison" (one-line form))
        (derivative-along signs rate))))

(defun derivative-of-abs (form rate)
  (let ((slope (derivative-along (second form) rate)))
    (cond ((eql slope 0) 0)
          (*slope-of-abs* (product-of slope (maxima::simplify `((maxima::%signum) ,(second form)))))
          (t (product-of slope (outer-derivative form))))))

(setf (get 'maxima::mabs 'derivative-rule) 'derivative-of-abs)

(dolist (operator *written-by-signs*)
  (setf (get operator 'derivative-rule) 'derivative-by-signs))

(defun derivative-between-jumps (form rate)
  (declare (ignore form rate))
  0)

(defun derivative-of-mod (form rate)
  "Of mod(u, v) = u - v floor(u/v)."
  (destructuring-bind (u v) (rest form)
    (maxima::sub (derivative-along u rate)
                 (maxima::mul (derivative-along v rate) (function-of 'maxima::$floor (maxima::div u v))))))

(dolist (operator *floors*)
  (setf (get operator 'derivative-rule) 'derivative-between-jumps))

(dolist (operator '(maxima::$mod maxima::%mod))
  (setf (get operator 'derivative-rule) 'derivative-of-mod))

(defun derivative-of-product (form rate)
  (sum-of (loop for factor in (rest form)
                for slope = (derivative-along factor rate)
                unless (eql slope 0)
                  collect (apply #'product-of slope (remove factor (rest form) :test #'eq :count 1)))))

(defun derivative-of-power (form rate)
  (destructuring-bind (base exponent) (rest form)
    (let ((slope (derivative-along base rate)) (growth (derivative-along exponent rate)))
      (sum-of (list (if (eql slope 0)
                        0
                        (product-of exponent (power-of base (maxima::add exponent -1)) slope))
                    (if (eql growth 0)
                        0
                        (product-of form growth (maxima::simplify `((maxima::%log) ,base)))))))))

(defun derivative-of-function (form rate)
  "Functions of one argument by the chain rule; whatever else there is, variable by variable."
  (multiple-value-bind (function jet order) (function-along-a-line form)
    (cond ((and (= (length form) 2) (get (caar form) 'maxima::grad))
           (let ((slope (derivative-along (second form) rate)))
             (if (eql slope 0) 0 (product-of slope (outer-derivative form)))))
          (function
           (product-of (maxima::div (derivative-along (second function) rate) (maxima::sdiff (second function) jet))
                       (derived function (list jet (1+ order)))))
          (t (sum-of (loop for symbol in (symbols-in form)
                           for slope = (funcall rate symbol)
                           unless (eql slope 0)
                             collect (product-of slope (maxima::sdiff form symbol))))))))

(defun function-along-a-line (form)
  "If FORM is V(u), or a derivative of that by one jet, V being unknown and u linear with constant coefficients in two
symbols or more: V(u), the first jet in u and the order.  All derivatives of V(u) are written as those by that jet."
  (let* ((derivative (eq (caar form) 'maxima::%derivative)) (function (if derivative (second form) form)))
    (when (and (consp function) (= (length function) 2) (consp (second function))
               (not (get (caar function) 'maxima::grad)) (eql #\$ (char (symbol-name (caar function)) 0)))
      (let* ((argument (second function))
             (jets (jets-in argument))
             (slopes (mapcar (lambda (symbol) (maxima::sdiff argument symbol)) (symbols-in argument))))
        (when (and jets (rest (symbols-in argument))
                   (notany #'jets-in slopes)
                   (or (not derivative)
                       (and (eq (third form) (first jets)) (integerp (fourth form)) (null (nthcdr 4 form)))))
          (values function (first jets) (if derivative (fourth form) 0)))))))

(defun outer-derivative (form)
  (let ((argument (second form)))
    (if (symbolp argument)
        (maxima::sdiff form argument)
        (let ((dummy 'maxima::|$argument`|))
          (maxima::maxima-substitute argument dummy (maxima::sdiff (list (first form) dummy) dummy))))))

(defun total-derivative (form time &optional (highest most-positive-fixnum))
  "d FORM / d TIME, jets of order above HIGHEST taken to have no derivative."
  (derivative-along form (lambda (symbol)
                           (let ((jet (jet-of symbol)))
                             (cond ((null jet) (maxima::sdiff symbol time))
                                   ((and (eq (third jet) time) (<= (second jet) highest))
                                    (jet (first jet) (1+ (second jet)) time))
                                   (t 0))))))

(defun partial-derivative (form variable)
  (derivative-along form (lambda (symbol) (if (eq symbol variable) 1 (maxima::sdiff symbol variable)))))

(defun gradient (form variables)
  "The partial derivatives of FORM by VARIABLES.  Of long sums only the terms that hold a jet are looked at for it."
  (let ((terms (terms-by-jets form)))
    (flet ((partial (variable)
             (if (jet-of variable)
                 (let ((present (gethash variable terms)))
                   (if present (partial-derivative (sum-of (reverse present)) variable) 0))
                 (partial-derivative form variable))))
      (if (numbered-p form)
          (mapcar (lambda (slope) (product-of slope (second form))) (gradient (third form) variables))
          (mapcar #'partial variables)))))

(defun numbered-p (form)
  "Whether FORM is a number times something else."
  (and (operator-p form 'maxima::mtimes) (= 3 (length form)) (maxima::mnump (second form))))

(defun terms-by-jets (form)
  "A table from the jets in FORM to lists of its terms that hold them, the last term first."
  (let ((table (make-hash-table :test 'eq)))
    (dolist (term (if (operator-p form 'maxima::mplus) (rest form) (list form)) table)
      (labels ((walk (part)
                 (cond ((jet-of part)
                        (unless (eq term (first (gethash part table))) (push term (gethash part table))))
                       ((consp part) (mapc #'walk (rest part))))))
        (walk term)))))

;;; Unknown functions of one argument u.  All derivatives of V(u) can be written with those by one jet,
;;; W(k) = d^k V(u)/dx^k, since dV(u)/dy = r W(1) with r = (du/dy)/(du/dx).

(defun along-one-jet (form)
  "FORM, derivatives of unknown functions V(u) of several symbols all written as those by the first one in u, a jet if
there is one."
  (labels ((composite-derivative-p (form)
             (and (eq (caar form) 'maxima::%derivative) (composite-p (second form))
                  (loop for (nil order) on (cddr form) by #'cddr always (integerp order))))
           (walk (form)
             (cond ((not (some-part #'composite-derivative-p form)) form)
                   ((composite-derivative-p form) (derivative-by-one-jet (second form) (cddr form)))
                   (t (with-arguments form (mapcar #'walk (rest form)))))))
    (walk form)))

(defun composite-p (form)
  (and (consp form) (= (length form) 2) (consp (second form)) (not (get (caar form) 'maxima::grad))
       (rest (directions-of (second form)))))

(defun directions-of (argument)
  "The jets in ARGUMENT, then the other symbols."
  (let ((jets (jets-in argument)))
    (append jets (sort (set-difference (symbols-in argument) jets) #'string< :key #'symbol-name))))

(defun derivative-by-one-jet (function steps)
  (let* ((argument (second function)) (jet (first (directions-of argument)))
         (sum (list (cons 0 1))))                          ; pairs of k and the coefficient of W(k)
    (loop for (variable order) on steps by #'cddr
          do (loop repeat order
                   do (setq sum (loop for (k . coefficient) in sum
                                      collect (cons k (maxima::sdiff coefficient variable))
                                      append (slope-of-w k coefficient argument jet variable)))))
    (sum-of (loop for (k . coefficient) in sum
                  collect (product-of coefficient (derived function (if (= k 0) '() (list jet k))))))))

(defun slope-of-w (k coefficient argument jet variable)
  "COEFFICIENT times the derivative of W(K) by VARIABLE: the sum over j of binomial(k, j) d^j r/dx^j W(k+1-j)."
  (let ((ratio (maxima::div (maxima::sdiff argument variable) (maxima::sdiff argument jet))) (binomial 1))
    (loop for j from 0 to k
          collect (cons (- (1+ k) j) (maxima::mul binomial coefficient ratio))
          do (setq ratio (maxima::sdiff ratio jet)
                   binomial (/ (* binomial (- k j)) (1+ j))))))

;;; Change of variables

(defun replaced (form rules inverse drift new time)
  "FORM under RULES, an alist of jets.  A derivative of an undefined function by the k-th old variable becomes the sum
of its derivatives by the NEW ones, times column k of INVERSE; one by TIME loses the sum times DRIFT."
  (labels ((slope (form direction)
             (sum-of (loop for variable in new
                           for factor in direction
                           collect (product-of factor (partial-derivative form variable)))))
           (walk (form)
             (cond ((symbolp form) (let ((rule (assoc form rules))) (if rule (cdr rule) form)))
                   ((atom form) form)
                   ((eq (caar form) 'maxima::%derivative) (derivative (second form) (cddr form)))
                   (t (with-arguments form (mapcar #'walk (rest form))))))
           (derivative (function steps)
             (destructuring-bind (variable order . others) steps
               (let ((inner (walk (derived function (if (eql order 1) others (list* variable (1- order) others)))))
                     (place (position variable rules :key #'car)))
                 (cond ((and place (< place (length inverse)))
                        (slope inner (mapcar (lambda (row) (nth place row)) inverse)))
                       (place (complain "a derivative of an undefined function by a velocity or momentum cannot be ~
                                         taken into new variables"))
                       ((eq variable time) (maxima::sub (partial-derivative inner time) (slope inner drift)))
                       (t (derived inner (list variable 1))))))))
    (walk form)))

;;; The thin layer

(defun map-over-lists (function form)
  (if (operator-p form 'maxima::mlist)
      (cons (first form) (mapcar (lambda (part) (map-over-lists function part)) (rest form)))
      (funcall function form)))

(maxima::defmfun maxima::$anmech_jet (variable order time)
  "anmech_jet(variable, order, time): the symbol inside the package for diff(variable, time, order)."
  (map-over-lists (lambda (variable) (jet variable order time)) variable))

(maxima::defmfun maxima::$anmech_to_jets (form variables time)
  "anmech_to_jets(expr, [variable, ...], time)"
  (let ((table (make-hash-table :test #'equal)))
    (dolist (variable (rest variables)) (setf (gethash (plain-key variable) table) t))
    (to-jets form table time)))

(maxima::defmfun maxima::$anmech_from_jets (form)
  "anmech_from_jets(expr): coordinates and derivatives again."
  (from-jets form))

(maxima::defmfun maxima::$anmech_jets_in (form)
  "anmech_jets_in(expr): list of the jets that occur."
  (cons '(maxima::mlist maxima::simp) (jets-in form)))

(maxima::defmfun maxima::$anmech_jet_order (symbol)
  "anmech_jet_order(symbol): order of the derivative that it stands for; -1 if it is no jet."
  (if (jet-of symbol) (second (jet-of symbol)) -1))

(maxima::defmfun maxima::$anmech_total (form time &optional (highest most-positive-fixnum))
  "anmech_total(expr, time, [highest]): the total derivative; jets above order HIGHEST count as constants."
  (map-over-lists (lambda (form) (total-derivative form time highest)) form))

(maxima::defmfun maxima::$anmech_partial (form variable)
  "anmech_partial(expr, variable): the partial derivative; term by term over lists."
  (poll)
  (map-over-lists (lambda (form) (partial-derivative form variable)) form))

(maxima::defmfun maxima::$anmech_partials (form variables)
  "anmech_partials(expr, [variable, ...]): the list of its partial derivatives; of a list, these lists by variables."
  (poll)
  (maxima-list (if (operator-p form 'maxima::mlist)
                   (mapcar (lambda (variable) (maxima::$anmech_partial form variable)) (rest variables))
                   (gradient form (rest variables)))))

(maxima::defmfun maxima::$anmech_along_one_jet (form)
  "anmech_along_one_jet(expr): derivatives of V(u), V unknown, by several jets written as those by one."
  (map-over-lists #'along-one-jet form))

(maxima::defmfun maxima::$anmech_jet_parts (symbol)
  "anmech_jet_parts(jet): [variable, order, time]."
  (cons '(maxima::mlist maxima::simp) (jet-of symbol)))

(maxima::defmfun maxima::$anmech_replaced (form rules inverse drift new time)
  "anmech_replaced(expr, [old = value, ...], inverse, drift, new, time): see replaced; INVERSE is a matrix."
  (let ((alist (mapcar (lambda (rule) (cons (second rule) (third rule))) (rest rules)))
        (rows (mapcar #'rest (rest inverse))))
    (map-over-lists (lambda (form) (replaced form alist rows (rest drift) (rest new) time)) form)))

;;; What the session shows and assumes

(setq *outer-form* #'from-jets)
(pushnew 'assume-for-jets *fact-readers*)
